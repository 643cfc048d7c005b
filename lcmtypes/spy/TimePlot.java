package gastronaut.spy;

import gastronaut.spy.CapsuleHistory.Sample;
import java.awt.BasicStroke;
import java.awt.Color;
import java.awt.FontMetrics;
import java.awt.Graphics2D;
import java.awt.Rectangle;
import java.awt.geom.Line2D;
import java.awt.geom.Path2D;
import java.awt.geom.Rectangle2D;
import java.util.List;
import java.util.function.Function;
import java.util.function.ToDoubleFunction;

/** Curves and bands over one common time axis, whose right end is the newest sample. */
final class TimePlot {
  static final int AXIS_HEIGHT = 18;

  private static final int TICK_SECONDS = 10;
  private static final int LABELS = 58;  // pixels left of the curves
  private static final double LONGEST_GAP = 0.6;  // seconds; above, the curve is broken
  private static final double LEAST_SPAN = 2;  // mm: a capsule at rest shows its noise small

  private final Graphics2D graphics;
  private final List<Sample> samples;
  private final Sample newest;
  private final int width;

  TimePlot(Graphics2D graphics, List<Sample> samples, int width) {
    this.graphics = graphics;
    this.samples = samples;
    this.newest = samples.get(samples.size() - 1);
    this.width = width;
  }

  int width() {
    return width;
  }

  /** A curve with a band of plus and minus sigma, scaled to what it shows. */
  void paintTrace(Rectangle box, ToDoubleFunction<Sample> value, ToDoubleFunction<Sample> sigma,
      String label, Color colour) {
    double low = Double.POSITIVE_INFINITY;
    double high = Double.NEGATIVE_INFINITY;
    for (Sample sample : samples) {
      double at = value.applyAsDouble(sample);
      if (!Double.isFinite(at)) continue;
      low = Math.min(low, at);
      high = Math.max(high, at);
    }
    if (low > high) low = high = 0;
    double middle = (low + high) / 2;
    double half = 0.55 * Math.max(high - low, LEAST_SPAN);
    paintFrame(box, middle - half, middle + half);
    paintLabel(box, label, colour);
    paintCurves(box, middle - half, middle + half, value, sigma, colour);
  }

  /** Two curves of 0..1. */
  void paintFractions(
      Rectangle box, ToDoubleFunction<Sample> nominal, ToDoubleFunction<Sample> alpha) {
    paintFrame(box, 0, 1);
    int half = box.height / 2;
    paintLabel(new Rectangle(box.x, box.y, box.width, half), "p nominal", Theme.FIRST);
    paintLabel(new Rectangle(box.x, box.y + half, box.width, half), "alpha", Theme.SECOND);
    paintCurves(box, -0.05, 1.05, nominal, sample -> 0, Theme.FIRST);
    paintCurves(box, -0.05, 1.05, alpha, sample -> 0, Theme.SECOND);
  }

  /** A strip that tells a state by colour, with its name where there is room. */
  void paintBands(Rectangle box, Function<Sample, Color> colour, Function<Sample, String> name) {
    graphics.setColor(Theme.FIELD);
    graphics.fillRect(LABELS, box.y, box.width - LABELS, box.height);
    graphics.setFont(Theme.SMALL);
    int first = 0;
    for (int i = 1; i <= samples.size(); ++i) {
      boolean continues = i < samples.size()
          && colour.apply(samples.get(i)).equals(colour.apply(samples.get(first)))
          && name.apply(samples.get(i)).equals(name.apply(samples.get(first))) && !gapBefore(i);
      if (continues) continue;
      // A band ends where the next begins, and has a width even when it is one sample.
      double left = x(box, samples.get(first));
      boolean touches = i < samples.size() && !gapBefore(i);
      double right = touches ? x(box, samples.get(i)) : x(box, samples.get(i - 1)) + 1;
      graphics.setColor(colour.apply(samples.get(first)));
      graphics.fill(new Rectangle2D.Double(left, box.y, Math.max(1, right - left), box.height));
      String text = name.apply(samples.get(first));
      if (graphics.getFontMetrics().stringWidth(text) + 4 < right - left) {
        graphics.setColor(Color.BLACK);
        graphics.drawString(text, (float) left + 3, box.y + box.height - 4);
      }
      first = i;
    }
  }

  void paintLabel(Rectangle box, String label, Color colour) {
    graphics.setFont(Theme.SMALL);
    graphics.setColor(colour);
    graphics.drawString(label, 2, box.y + box.height / 2 + 4);
  }

  void paintAxis(int top) {
    graphics.setFont(Theme.SMALL);
    graphics.setColor(Theme.FAINT);
    FontMetrics metrics = graphics.getFontMetrics();
    for (int seconds = 0; seconds <= CapsuleHistory.SECONDS; seconds += TICK_SECONDS) {
      String text = seconds == 0 ? "now" : "\u2212" + seconds + " s";
      double at = LABELS + (1 - seconds / CapsuleHistory.SECONDS) * (width - LABELS);
      double textLeft =
          Math.min(at - metrics.stringWidth(text) / 2.0, width - metrics.stringWidth(text));
      graphics.drawString(text, (float) textLeft, top + metrics.getAscent());
    }
  }

  private void paintFrame(Rectangle box, double low, double high) {
    graphics.setColor(Theme.FIELD);
    graphics.fillRect(LABELS, box.y, box.width - LABELS, box.height);
    graphics.setStroke(new BasicStroke(1));
    graphics.setColor(Theme.GRID);
    for (int seconds = TICK_SECONDS; seconds < CapsuleHistory.SECONDS; seconds += TICK_SECONDS) {
      double at = LABELS + (1 - seconds / CapsuleHistory.SECONDS) * (width - LABELS);
      graphics.draw(new Line2D.Double(at, box.y, at, box.y + box.height));
    }
    graphics.setFont(Theme.SMALL);
    FontMetrics metrics = graphics.getFontMetrics();
    graphics.setColor(Theme.FAINT);
    String top = Text.threeDigits(high);
    String bottom = Text.threeDigits(low);
    graphics.drawString(top, LABELS - 4 - metrics.stringWidth(top), box.y + metrics.getAscent());
    graphics.drawString(bottom, LABELS - 4 - metrics.stringWidth(bottom), box.y + box.height - 2);
  }

  private void paintCurves(Rectangle box, double low, double high, ToDoubleFunction<Sample> value,
      ToDoubleFunction<Sample> sigma, Color colour) {
    Graphics2D inside = (Graphics2D) graphics.create();
    inside.clipRect(LABELS, box.y, box.width - LABELS, box.height);
    double scale = box.height / (high - low);
    Path2D curve = new Path2D.Double();
    inside.setColor(Theme.transparent(colour, 90));
    double lastX = Double.NaN;
    for (int i = 0; i < samples.size(); ++i) {
      double at = value.applyAsDouble(samples.get(i));
      double band = scale * sigma.applyAsDouble(samples.get(i));
      double x = x(box, samples.get(i));
      if (!Double.isFinite(at)) {
        lastX = Double.NaN;
        continue;
      }
      double y = box.y + scale * (high - at);
      boolean starts = Double.isNaN(lastX) || gapBefore(i);
      if (starts) {
        curve.moveTo(x, y);
      } else {
        curve.lineTo(x, y);
        // NaN and infinite sigma leave no band; the clip cuts what is large.
        if (band > 0 && Double.isFinite(band)) {
          double reach = Math.min(band, 2.0 * box.height);
          inside.fill(new Rectangle2D.Double(lastX, y - reach, x - lastX, 2 * reach));
        }
      }
      lastX = x;
    }
    inside.setStroke(new BasicStroke(1.5f));
    inside.setColor(colour);
    inside.draw(curve);
    inside.dispose();
  }

  private boolean gapBefore(int i) {
    return CapsuleHistory.age(samples.get(i), samples.get(i - 1)) > LONGEST_GAP;
  }

  private static double fraction(Sample sample, Sample newest) {
    return 1 + CapsuleHistory.age(sample, newest) / CapsuleHistory.SECONDS;
  }

  private double x(Rectangle box, Sample sample) {
    return LABELS + fraction(sample, newest) * (box.width - LABELS);
  }
}
