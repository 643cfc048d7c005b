package gastronaut.spy;

import gastronaut.capsule_state_t;
import gastronaut.depth_image_t;
import gastronaut.hall_array_t;
import gastronaut.image_t;
import gastronaut.process_status_t;
import java.util.Map;
import java.util.function.Function;

/** Which view shows which type of message. */
public final class MessagePanels {
  private static final Map<Long, Function<String, MessagePanel>> VIEWS = Map.of(
      image_t.LCM_FINGERPRINT, PicturePanel::new, depth_image_t.LCM_FINGERPRINT, DepthPanel::new,
      hall_array_t.LCM_FINGERPRINT, HallArrayPanel::new, capsule_state_t.LCM_FINGERPRINT,
      CapsuleStatePanel::new, process_status_t.LCM_FINGERPRINT, ProcessStatusPanel::new);

  private MessagePanels() {}

  public static boolean canShow(long fingerprint) {
    return VIEWS.containsKey(fingerprint);
  }

  /** For a type that canShow(). */
  public static MessagePanel create(long fingerprint, String channel) {
    return VIEWS.get(fingerprint).apply(channel);
  }
}
