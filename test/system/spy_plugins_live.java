// Opens the views' windows and stock lcm-spy on the screen while a log is played, looks at what
// they show, and closes them again.
// usage: java -cp ... spy_plugins_live.java WORK_DIRECTORY CHANNEL...   (needs a display)

import gastronaut.spy.MessagePanel;
import gastronaut.spy.SpyWindows;
import java.awt.Component;
import java.awt.Container;
import java.awt.Frame;
import java.awt.Rectangle;
import java.awt.Robot;
import java.awt.Toolkit;
import java.awt.event.MouseEvent;
import java.awt.image.BufferedImage;
import java.io.File;
import java.util.ArrayList;
import java.util.Arrays;
import java.util.List;
import java.util.function.BooleanSupplier;
import javax.imageio.ImageIO;
import javax.swing.JTable;
import javax.swing.SwingUtilities;
import lcm.spy.Spy;

class SpyPluginsLive {
  static final long PATIENCE = 60_000;  // milliseconds, on a busy machine
  static final int MESSAGES = 3;  // the first can come before the window is there
  static final int LEAST_COLOURS = 12;  // an empty window has one, its title line a few more
  static final String SPY_TITLE = "LCM Spy";

  public static void main(String[] arguments) throws Exception {
    File work = new File(arguments[0]);
    String[] channels = Arrays.copyOfRange(arguments, 1, arguments.length);
    try {
      run(work, channels);
    } catch (Throwable problem) {
      problem.printStackTrace(System.out);
      System.exit(1);
    }
    System.out.println("all windows showed their channels");
    // The last window ends the program.
    SwingUtilities.invokeAndWait(() -> Arrays.stream(Frame.getFrames()).forEach(Frame::dispose));
  }

  static void run(File work, String[] channels) throws Exception {
    Thread windows = new Thread(() -> openWindows(channels));
    windows.setDaemon(true);
    windows.start();
    for (String channel : channels) {
      await(()
                -> panels(channel).stream().anyMatch(SpyPluginsLive::showsMessages),
          "a window that shows " + channel);
    }
    BufferedImage screen = photograph(new File(work, "windows.png"));
    for (String channel : channels) {
      checkColours(
          screen, SwingUtilities.getWindowAncestor(panels(channel).get(0)).getBounds(), channel);
    }
    openThroughSpy(channels[0]);
    photograph(new File(work, "lcm_spy.png"));
    closeAllBut(channels[0]);
  }

  static void openWindows(String[] channels) {
    try {
      SpyWindows.main(channels);
    } catch (InterruptedException ended) {
      throw new AssertionError(ended);
    }
  }

  /** A double click on the channel in lcm-spy's table opens the plugin's view. */
  static void openThroughSpy(String channel) throws Exception {
    Spy.main(new String[0]);
    await(() -> row(channel) >= 0, channel + " in lcm-spy's table");
    SwingUtilities.invokeAndWait(() -> {
      JTable table = table();
      Rectangle cell = table.getCellRect(row(channel), 0, true);
      table.dispatchEvent(new MouseEvent(table, MouseEvent.MOUSE_CLICKED, 0, 0,
          (int) cell.getCenterX(), (int) cell.getCenterY(), 2, false, MouseEvent.BUTTON1));
    });
    await(()
              -> panels(channel).size() == 2
            && panels(channel).stream().allMatch(SpyPluginsLive::showsMessages),
        "lcm-spy's view of " + channel);
  }

  /** A closed window listens no more: its decoder thread ends. */
  static void closeAllBut(String channel) throws Exception {
    SwingUtilities.invokeAndWait(() -> {
      for (Frame frame : Frame.getFrames()) {
        if (!frame.getTitle().equals(channel)) frame.dispose();
      }
      panels(channel).stream().skip(1).forEach(
          panel -> SwingUtilities.getWindowAncestor(panel).dispose());
    });
    await(() -> decoders() == 1, "the end of the closed windows' threads");
  }

  static long decoders() {
    return Thread.getAllStackTraces()
        .keySet()
        .stream()
        .filter(thread -> thread.getName().equals("decoder"))
        .count();
  }

  static boolean showsMessages(MessagePanel panel) {
    return panel.messages() >= MESSAGES && panel.problem().isEmpty();
  }

  static BufferedImage photograph(File file) throws Exception {
    Robot robot = new Robot();
    robot.waitForIdle();
    Thread.sleep(200);  // two repaints more
    BufferedImage screen =
        robot.createScreenCapture(new Rectangle(Toolkit.getDefaultToolkit().getScreenSize()));
    ImageIO.write(screen, "png", file);
    return screen;
  }

  static void checkColours(BufferedImage screen, Rectangle window, String channel) {
    Rectangle seen = window.intersection(new Rectangle(screen.getWidth(), screen.getHeight()));
    long colours =
        Arrays.stream(screen.getRGB(seen.x, seen.y, seen.width, seen.height, null, 0, seen.width))
            .distinct()
            .count();
    if (colours < LEAST_COLOURS) {
      throw new AssertionError(channel + "'s window has " + colours + " colours");
    }
  }

  static void await(BooleanSupplier condition, String what) throws InterruptedException {
    long end = System.currentTimeMillis() + PATIENCE;
    while (!condition.getAsBoolean()) {
      if (System.currentTimeMillis() > end) throw new AssertionError("waited in vain for " + what);
      Thread.sleep(50);
    }
  }

  static List<MessagePanel> panels(String channel) {
    List<MessagePanel> found = new ArrayList<>();
    for (Frame frame : Frame.getFrames()) {
      if (!frame.isShowing()) continue;
      collect(frame, MessagePanel.class, found);
    }
    found.removeIf(panel -> !panel.channel().equals(channel));
    return found;
  }

  static JTable table() {
    List<JTable> tables = new ArrayList<>();
    for (Frame frame : Frame.getFrames()) {
      if (frame.getTitle().equals(SPY_TITLE)) collect(frame, JTable.class, tables);
    }
    return tables.isEmpty() ? null : tables.get(0);
  }

  static int row(String channel) {
    JTable table = table();
    if (table == null) return -1;
    for (int row = 0; row < table.getRowCount(); ++row) {
      if (channel.equals(table.getValueAt(row, 0))) return row;
    }
    return -1;
  }

  static <T> void collect(Container container, Class<T> type, List<T> found) {
    for (Component component : container.getComponents()) {
      if (type.isInstance(component)) found.add(type.cast(component));
      if (component instanceof Container) collect((Container) component, type, found);
    }
  }
}
