package gastronaut.spy;

import gastronaut.process_status_t;
import java.awt.Color;
import java.awt.Dimension;
import java.awt.FontMetrics;
import java.awt.Graphics2D;
import java.io.IOException;
import java.util.ArrayList;
import java.util.List;
import java.util.TreeMap;

/** What each process says of itself, one line a process, its message below. */
public final class ProcessStatusPanel extends MessagePanel {
  private static final int MAX_PROCESSES = 64;
  private static final double SILENCE = 3;  // seconds; a status is due each second
  private static final double MEGABYTE = 1 << 20;
  private static final double LONGEST_LATENCY = 3600;  // seconds; more only when a log is played
  private static final int GAP = 16;  // pixels between columns
  private static final String[] HEADINGS = {"process", "host", "state", "received", "published",
      "dropped", "late", "lost", "p50, ms", "p99, ms", "CPU", "MB"};

  private record Line(process_status_t status, double arrival) {
    boolean isSilent() {
      return seconds() - arrival > SILENCE;
    }
  }

  private final TreeMap<String, Line> lines = new TreeMap<>();  // guarded by itself

  public ProcessStatusPanel(String channel) {
    super(channel, 256, new Dimension(900, 190));
  }

  @Override
  protected void decode(byte[] bytes) throws IOException {
    process_status_t status = new process_status_t(bytes);
    String key = status.name + "@" + status.host;
    synchronized (lines) {
      if (!lines.containsKey(key) && lines.size() >= MAX_PROCESSES) {
        throw new IOException("more than " + MAX_PROCESSES + " processes");
      }
      lines.put(key, new Line(status, seconds()));
    }
  }

  @Override
  protected String summary() {
    synchronized (lines) {
      return lines.size() + (lines.size() == 1 ? " process" : " processes");
    }
  }

  @Override
  protected void paintView(Graphics2D graphics, int width, int height) {
    List<Line> shown;
    synchronized (lines) {
      shown = new ArrayList<>(lines.values());
    }
    graphics.setFont(Theme.FONT);
    FontMetrics metrics = graphics.getFontMetrics();
    int lineHeight = metrics.getHeight() + 3;
    int[] places = places(shown, metrics);
    int baseline = lineHeight;
    graphics.setColor(Theme.FAINT);
    paintRow(graphics, HEADINGS, places, baseline);
    for (Line line : shown) {
      baseline += lineHeight;
      graphics.setColor(line.isSilent() ? Theme.BAD : stateColour(line.status().state));
      paintRow(graphics, cells(line), places, baseline);
      if (line.status().message.isEmpty()) continue;
      baseline += lineHeight;
      graphics.drawString(line.status().message, GAP, baseline);
    }
  }

  /** Where the columns begin, each as wide as its widest cell. */
  private static int[] places(List<Line> shown, FontMetrics metrics) {
    int[] places = new int[HEADINGS.length];
    for (int column = 0; column + 1 < places.length; ++column) {
      int widest = metrics.stringWidth(HEADINGS[column]);
      for (Line line : shown) {
        widest = Math.max(widest, metrics.stringWidth(cells(line)[column]));
      }
      places[column + 1] = places[column] + widest + GAP;
    }
    return places;
  }

  private static void paintRow(Graphics2D graphics, String[] cells, int[] places, int baseline) {
    for (int i = 0; i < cells.length; ++i) graphics.drawString(cells[i], places[i], baseline);
  }

  private static String[] cells(Line line) {
    process_status_t status = line.status();
    String state = line.isSilent() ? String.format("silent %.0f s", seconds() - line.arrival())
                                   : stateName(status.state);
    return new String[] {status.name, status.host, state, Long.toString(status.received),
        Long.toString(status.published), Long.toString(status.dropped), Long.toString(status.late),
        Long.toString(status.lost), latency(status.latency_p50), latency(status.latency_p99),
        Text.threeDigits(status.cpu), Text.threeDigits(status.resident_bytes / MEGABYTE)};
  }

  private static String latency(double seconds) {
    return seconds > LONGEST_LATENCY ? "> 1 h" : Text.threeDigits(1e3 * seconds);
  }

  private static String stateName(int state) {
    switch (state) {
      case process_status_t.STATE_STARTING:
        return "starting";
      case process_status_t.STATE_RUNNING:
        return "running";
      case process_status_t.STATE_DEGRADED:
        return "degraded";
      case process_status_t.STATE_FAILED:
        return "failed";
      default:
        return "state " + state;
    }
  }

  private static Color stateColour(int state) {
    switch (state) {
      case process_status_t.STATE_RUNNING:
        return Theme.GOOD;
      case process_status_t.STATE_DEGRADED:
        return Theme.FAIR;
      case process_status_t.STATE_FAILED:
        return Theme.BAD;
      default:
        return Theme.TEXT;
    }
  }

  private static double seconds() {
    return System.nanoTime() * 1e-9;
  }
}
