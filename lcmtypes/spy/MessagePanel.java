package gastronaut.spy;

import java.awt.Color;
import java.awt.Dimension;
import java.awt.FontMetrics;
import java.awt.Graphics;
import java.awt.Graphics2D;
import java.awt.RenderingHints;
import java.io.IOException;
import java.util.List;
import javax.swing.JPanel;

/**
 * A view of one channel's messages. show() takes a message on any thread but the event thread;
 * a damaged one is said in a line of text and leaves the last good view as it was. While the panel
 * is on the screen a Feed brings it the messages and repaints it.
 */
public abstract class MessagePanel extends JPanel {
  private static final int MARGIN = 6;

  private final String channel;
  private final int backlog;
  private final MessageRate rate = new MessageRate();
  private volatile String problem = "";
  private Feed feed;

  /** backlog: how many messages may wait for their turn before the oldest is skipped. */
  protected MessagePanel(String channel, int backlog, Dimension size) {
    this.channel = channel;
    this.backlog = backlog;
    setPreferredSize(size);
    setBackground(Theme.BACKGROUND);
    setFont(Theme.FONT);
  }

  /** The type's decoder and what the view keeps of the message; the message's text on damage. */
  protected abstract void decode(byte[] message) throws IOException;

  /** As decode(), for a message of a companion. */
  protected void decodeCompanion(byte[] message) throws IOException {}

  /** Paints the view below the title line, origin at its upper left corner; event thread. */
  protected abstract void paintView(Graphics2D graphics, int width, int height);

  /** What the title line says of the last message. */
  protected abstract String summary();

  /** Further channels that the view draws from. */
  protected List<String> companions() {
    return List.of();
  }

  public final String channel() {
    return channel;
  }

  /** Why the last message could not be shown; empty when it was. */
  public final String problem() {
    return problem;
  }

  public final long messages() {
    return rate.count();
  }

  public final void show(byte[] message) {
    try {
      decode(message);
      problem = "";
    } catch (IOException | RuntimeException | OutOfMemoryError damage) {
      // A length field that lies makes the generated decoders ask for memory that is not there.
      problem = "damaged message: " + describe(damage);
    }
  }

  /** A companion's message; its damage is shown until the channel's own next message. */
  public final void showCompanion(byte[] message) {
    try {
      decodeCompanion(message);
    } catch (IOException | RuntimeException | OutOfMemoryError damage) {
      problem = "damaged message of a companion: " + describe(damage);
    }
  }

  @Override
  public void addNotify() {
    super.addNotify();
    if (feed == null) feed = new Feed(this, backlog, rate);
  }

  @Override
  public void removeNotify() {
    if (feed != null) feed.close();
    feed = null;
    super.removeNotify();
  }

  @Override
  protected final void paintComponent(Graphics graphics) {
    super.paintComponent(graphics);
    Graphics2D view = (Graphics2D) graphics.create();
    view.setRenderingHint(RenderingHints.KEY_ANTIALIASING, RenderingHints.VALUE_ANTIALIAS_ON);
    view.setRenderingHint(
        RenderingHints.KEY_TEXT_ANTIALIASING, RenderingHints.VALUE_TEXT_ANTIALIAS_ON);
    FontMetrics metrics = view.getFontMetrics();
    int line = metrics.getHeight() + 2 * MARGIN;
    paintTitle(view, MARGIN + metrics.getAscent());
    int height = getHeight() - line - MARGIN;
    int width = getWidth() - 2 * MARGIN;
    if (width > 0 && height > 0) {
      view.translate(MARGIN, line);
      view.clipRect(0, 0, width, height);
      paintView(view, width, height);
    }
    view.dispose();
  }

  private void paintTitle(Graphics2D graphics, int baseline) {
    Color colour = Theme.TEXT;
    String title = channel + "   " + rate.text() + "   " + summary();
    if (!problem.isEmpty()) {
      title = channel + "   " + problem;
      colour = Theme.BAD;
    } else if (rate.isSilent()) {
      colour = Theme.BAD;
    }
    graphics.setColor(colour);
    graphics.drawString(title, MARGIN, baseline);
  }

  private static String describe(Throwable damage) {
    String text = damage.getMessage();
    return text == null ? damage.getClass().getSimpleName() : text;
  }
}
