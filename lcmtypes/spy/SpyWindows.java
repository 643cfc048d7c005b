package gastronaut.spy;

import java.awt.Dimension;
import java.awt.Rectangle;
import java.awt.Toolkit;
import java.awt.event.WindowAdapter;
import java.awt.event.WindowEvent;
import java.io.IOException;
import java.util.ArrayList;
import java.util.HashSet;
import java.util.List;
import java.util.Set;
import javax.swing.JFrame;
import javax.swing.SwingUtilities;
import lcm.lcm.LCM;
import lcm.lcm.LCMDataInputStream;
import lcm.lcm.LCMSubscriber;

/**
 * Opens a window for each channel that a view exists for, as soon as its first message comes:
 * SpyWindows [CHANNEL...], all channels without arguments. Ends with its last window.
 */
public final class SpyWindows implements LCMSubscriber {
  private static final int MAX_WINDOWS = 16;
  private static final int STEP = 4;  // pixels between the places that are tried

  private final Set<String> wanted;  // empty: every channel
  private final Set<String> opened = new HashSet<>();
  private final List<Rectangle> taken = new ArrayList<>();
  private int windows = 0;

  private SpyWindows(Set<String> wanted) {
    this.wanted = wanted;
  }

  public static void main(String[] channels) throws InterruptedException {
    System.err.println(
        "lcm-spy: waiting for messages; a window opens for each channel with a view");
    Bus.get().subscribe(".*", new SpyWindows(Set.of(channels)));
    // LCM's threads do not keep Java running before the first window does.
    Thread.currentThread().join();
  }

  @Override
  public synchronized void messageReceived(LCM bus, String channel, LCMDataInputStream stream) {
    if (opened.contains(channel) || opened.size() >= MAX_WINDOWS) return;
    if (!wanted.isEmpty() && !wanted.contains(channel)) return;
    try {
      if (stream.available() < Long.BYTES) return;
      long fingerprint = stream.readLong();
      if (!MessagePanels.canShow(fingerprint)) return;
      opened.add(channel);
      SwingUtilities.invokeLater(() -> open(MessagePanels.create(fingerprint, channel)));
    } catch (IOException impossible) {
      throw new AssertionError("a read from memory failed", impossible);
    }
  }

  private void open(MessagePanel panel) {
    JFrame frame = new JFrame(panel.channel());
    frame.setContentPane(panel);
    frame.setDefaultCloseOperation(JFrame.DISPOSE_ON_CLOSE);
    frame.addWindowListener(new WindowAdapter() {
      @Override
      public void windowClosed(WindowEvent event) {
        if (--windows == 0) System.exit(0);
      }
    });
    frame.pack();
    frame.setLocation(freePlace(frame.getSize()).getLocation());
    frame.setVisible(true);
    ++windows;
    System.err.println("lcm-spy: window for " + panel.channel());
  }

  /** The uppermost, then leftmost place where the window hides no other; else the corner. */
  private Rectangle freePlace(Dimension window) {
    Dimension screen = Toolkit.getDefaultToolkit().getScreenSize();
    Rectangle place = new Rectangle(window);
    for (place.y = 0; place.y + window.height <= screen.height; place.y += STEP) {
      for (place.x = 0; place.x + window.width <= screen.width; place.x += STEP) {
        if (taken.stream().noneMatch(place::intersects)) {
          taken.add(new Rectangle(place.x, place.y, place.width + STEP, place.height + STEP));
          return place;
        }
      }
    }
    return new Rectangle(window);
  }
}
