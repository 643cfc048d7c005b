package gastronaut.spy;

import java.lang.reflect.Field;
import java.net.MulticastSocket;
import java.net.SocketException;
import lcm.lcm.LCM;

/** The bus at LCM's default URL, with room for bursts. */
final class Bus {
  // As in every gastronaut URL; the kernel gives net.core.rmem_max at most. Java's LCM knows no
  // recv_buf_size and loses most of a map of a megabyte, and the pictures that come with it.
  private static final int RECEIVE_BUFFER = 33554432;  // bytes

  private static LCM bus;

  private Bus() {}

  static synchronized LCM get() {
    if (bus == null) {
      bus = LCM.getSingleton();
      for (Object provider : (Iterable<?>) member(LCM.class, "providers", bus)) enlarge(provider);
    }
    return bus;
  }

  private static void enlarge(Object provider) {
    if (!provider.getClass().getSimpleName().equals("UDPMulticastProvider")) return;
    try {
      ((MulticastSocket) member(provider.getClass(), "sock", provider))
          .setReceiveBufferSize(RECEIVE_BUFFER);
    } catch (SocketException refused) {
      System.err.println("lcm-spy: small receive buffer, messages may be lost: " + refused);
    }
  }

  private static Object member(Class<?> type, String name, Object object) {
    try {
      Field field = type.getDeclaredField(name);
      field.setAccessible(true);
      return field.get(object);
    } catch (ReflectiveOperationException unknown) {
      throw new IllegalStateException("not the LCM that the views were written for", unknown);
    }
  }
}
