package gastronaut.spy;

import gastronaut.capsule_state_t;
import gastronaut.spy.CapsuleHistory.Health;
import gastronaut.spy.CapsuleHistory.Sample;
import java.awt.Color;
import java.awt.Dimension;
import java.awt.Font;
import java.awt.Graphics2D;
import java.awt.Rectangle;
import java.io.IOException;
import java.util.List;

/**
 * The capsule's last 60 s: position with one sigma, status, what the fusion believes of each sensor
 * and why, and the path seen from above.
 */
public final class CapsuleStatePanel extends MessagePanel {
  private static final int GAP = 6;
  private static final double TRACES_WIDTH = 0.62;  // of the panel
  private static final double TRACES_HEIGHT = 0.6;
  private static final int STATUS_HEIGHT = 16;
  private static final double MILLIMETRES = 1e3;
  private static final String[] AXES = {"x", "y", "z"};
  private static final Color[] AXIS_COLOURS = {Theme.FIRST, Theme.SECOND, Theme.THIRD};

  private final CapsuleHistory history = new CapsuleHistory();

  public CapsuleStatePanel(String channel) {
    super(channel, 512, new Dimension(900, 540));
  }

  @Override
  protected void decode(byte[] bytes) throws IOException {
    capsule_state_t state = new capsule_state_t(bytes);
    if (state.num_sensors < 0) throw new IOException(state.num_sensors + " sensors");
    history.add(state);
    for (double coordinate : state.position) {
      if (!Double.isFinite(coordinate)) throw new IOException("position is not a number");
    }
  }

  @Override
  protected String summary() {
    List<Sample> samples = history.samples();
    return samples.isEmpty() ? "" : statusName(samples.get(samples.size() - 1).status());
  }

  @Override
  protected void paintView(Graphics2D graphics, int width, int height) {
    List<Sample> samples = history.samples();
    if (samples.isEmpty()) return;
    int left = (int) (TRACES_WIDTH * width);
    TimePlot time = new TimePlot(graphics, samples, left);
    paintStatus(time, new Rectangle(0, 0, left, STATUS_HEIGHT));
    int top = STATUS_HEIGHT + GAP;
    int bottom = height - TimePlot.AXIS_HEIGHT;
    int middle = top + (int) (TRACES_HEIGHT * (bottom - top));
    paintPositions(time, top, middle);
    paintSensors(time, samples, middle, bottom);
    time.paintAxis(bottom);
    paintReadout(graphics, samples.get(samples.size() - 1), left + 3 * GAP, width);
    int mapTop = 6 * graphics.getFontMetrics(Theme.FONT).getHeight();
    PathMap.paint(graphics, samples,
        new Rectangle(left + 3 * GAP, mapTop, width - left - 3 * GAP, height - mapTop));
  }

  private static void paintStatus(TimePlot time, Rectangle box) {
    time.paintLabel(box, "status", Theme.TEXT);
    time.paintBands(
        box, sample -> statusColour(sample.status()), sample -> statusName(sample.status()));
  }

  private static void paintPositions(TimePlot time, int top, int bottom) {
    int height = (bottom - top) / AXES.length;
    for (int axis = 0; axis < AXES.length; ++axis) {
      int shown = axis;
      time.paintTrace(new Rectangle(0, top + axis * height, time.width(), height - GAP),
          sample
          -> MILLIMETRES * sample.position()[shown],
          sample -> MILLIMETRES * sample.sigma()[shown], AXES[axis] + ", mm", AXIS_COLOURS[axis]);
    }
  }

  private static void paintSensors(TimePlot time, List<Sample> samples, int top, int bottom) {
    List<Health> now = samples.get(samples.size() - 1).sensors();
    if (now.isEmpty()) return;
    int height = (bottom - top) / now.size();
    for (int i = 0; i < now.size(); ++i) {
      int sensor = i;
      Rectangle box = new Rectangle(0, top + i * height, time.width(), height - GAP);
      Rectangle bands = new Rectangle(0, box.y, box.width, STATUS_HEIGHT);
      time.paintLabel(bands, now.get(i).name(), Theme.TEXT);
      time.paintBands(bands,
          sample -> healthColour(health(sample, sensor)), sample -> health(sample, sensor).cause());
      Rectangle curves =
          new Rectangle(0, bands.y + STATUS_HEIGHT, box.width, box.height - STATUS_HEIGHT);
      time.paintFractions(curves,
          sample -> health(sample, sensor).nominal(), sample -> health(sample, sensor).alpha());
    }
  }

  private static Health health(Sample sample, int sensor) {
    return sensor < sample.sensors().size() ? sample.sensors().get(sensor)
                                            : new Health("", Double.NaN, Double.NaN, false, "");
  }

  private static Color healthColour(Health health) {
    if (!health.cause().isEmpty()) return Theme.BAD;
    return health.used() ? Theme.GOOD : Theme.GRID;
  }

  private static void paintReadout(Graphics2D graphics, Sample now, int left, int right) {
    graphics.setFont(Theme.FONT.deriveFont(Font.BOLD, 16f));
    int line = graphics.getFontMetrics(Theme.FONT).getHeight();
    graphics.setColor(statusColour(now.status()));
    graphics.drawString(statusName(now.status()), left, line);
    graphics.setFont(Theme.FONT);
    graphics.setColor(Theme.TEXT);
    String[] rows = {"position  " + triple(now.position(), MILLIMETRES) + " mm",
        "\u03c3  " + triple(now.sigma(), MILLIMETRES) + " mm",
        "optical axis  " + triple(now.axis(), 1),
        "speed  " + Text.threeDigits(MILLIMETRES * now.speed()) + " mm/s     depth scale  "
            + Text.threeDigits(now.depthScale())};
    for (int row = 0; row < rows.length; ++row) {
      graphics.drawString(rows[row], left, (row + 2) * line + GAP / 2);
    }
  }

  private static String triple(double[] values, double factor) {
    return "(" + Text.threeDigits(factor * values[0]) + ", " + Text.threeDigits(factor * values[1])
        + ", " + Text.threeDigits(factor * values[2]) + ")";
  }

  private static String statusName(int status) {
    switch (status) {
      case capsule_state_t.STATUS_INITIALISING:
        return "initialising";
      case capsule_state_t.STATUS_NOMINAL:
        return "nominal";
      case capsule_state_t.STATUS_DEGRADED:
        return "degraded";
      case capsule_state_t.STATUS_PREDICTING:
        return "predicting";
      default:
        return "status " + status;
    }
  }

  private static Color statusColour(int status) {
    switch (status) {
      case capsule_state_t.STATUS_NOMINAL:
        return Theme.GOOD;
      case capsule_state_t.STATUS_DEGRADED:
        return Theme.FAIR;
      case capsule_state_t.STATUS_PREDICTING:
        return Theme.BAD;
      default:
        return Theme.FAINT;
    }
  }
}
