package gastronaut.spy;

import gastronaut.spy.CapsuleHistory.Sample;
import java.awt.BasicStroke;
import java.awt.Color;
import java.awt.FontMetrics;
import java.awt.Graphics2D;
import java.awt.Rectangle;
import java.awt.geom.Ellipse2D;
import java.awt.geom.Line2D;
import java.util.List;

/** The path from above: x to the right, y up, one scale for both; older is darker. */
final class PathMap {
  private static final double LEAST_SPAN = 0.02;  // metres
  private static final double MARGIN = 1.25;  // of the path's extent
  private static final double HEADING = 26;  // pixels of a level optical axis
  private static final int TICKS = 4;  // at least this many grid lines across

  private PathMap() {}

  static void paint(Graphics2D graphics, List<Sample> samples, Rectangle box) {
    if (box.width < 20 || box.height < 20) return;
    Graphics2D map = (Graphics2D) graphics.create();
    map.setColor(Theme.FIELD);
    map.fill(box);
    map.clip(box);
    double[] x = extent(samples, 0);
    double[] y = extent(samples, 1);
    double span =
        Math.max(LEAST_SPAN, Math.max(x[1] - x[0], (y[1] - y[0]) * box.width / box.height));
    double pixelsPerMetre = box.width / (MARGIN * span);
    // Origin at the path's centre, metres, y up.
    double centreX = (x[0] + x[1]) / 2;
    double centreY = (y[0] + y[1]) / 2;
    map.translate(box.getCenterX(), box.getCenterY());
    paintGrid(map, box, centreX, centreY, pixelsPerMetre);
    paintPath(map, samples, centreX, centreY, pixelsPerMetre);
    paintCapsule(map, samples.get(samples.size() - 1), centreX, centreY, pixelsPerMetre);
    map.dispose();
  }

  private static double[] extent(List<Sample> samples, int axis) {
    double low = Double.POSITIVE_INFINITY;
    double high = Double.NEGATIVE_INFINITY;
    for (Sample sample : samples) {
      double value = sample.position()[axis];
      if (!Double.isFinite(value)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    return low > high ? new double[] {0, 0} : new double[] {low, high};
  }

  private static void paintGrid(
      Graphics2D map, Rectangle box, double centreX, double centreY, double pixelsPerMetre) {
    double step = roundStep(box.width / pixelsPerMetre / TICKS);
    double halfWidth = box.width / 2.0;
    double halfHeight = box.height / 2.0;
    map.setFont(Theme.SMALL);
    double firstX = Math.ceil((centreX - halfWidth / pixelsPerMetre) / step) * step;
    for (double x = firstX; (x - centreX) * pixelsPerMetre < halfWidth; x += step) {
      double at = (x - centreX) * pixelsPerMetre;
      map.setColor(Theme.GRID);
      map.draw(new Line2D.Double(at, -halfHeight, at, halfHeight));
      map.setColor(Theme.FAINT);
      map.drawString(millimetres(x), (float) at + 2, (float) halfHeight - 3);
    }
    double firstY = Math.ceil((centreY - halfHeight / pixelsPerMetre) / step) * step;
    for (double y = firstY; (y - centreY) * pixelsPerMetre < halfHeight; y += step) {
      double at = -(y - centreY) * pixelsPerMetre;
      map.setColor(Theme.GRID);
      map.draw(new Line2D.Double(-halfWidth, at, halfWidth, at));
      map.setColor(Theme.FAINT);
      map.drawString(millimetres(y), (float) -halfWidth + 3, (float) at - 2);
    }
    String legend = "from above; x right, y up, mm";
    FontMetrics metrics = map.getFontMetrics();
    map.drawString(legend, (float) halfWidth - metrics.stringWidth(legend) - 3,
        (float) -halfHeight + metrics.getAscent() + 1);
  }

  private static String millimetres(double metres) {
    return Text.threeDigits(Math.rint(1e4 * metres) / 10);
  }

  /** The largest of 1, 2 and 5 times a power of ten that is not above the given step. */
  private static double roundStep(double step) {
    double power = Math.pow(10, Math.floor(Math.log10(step)));
    double factor = step / power;
    return power * (factor >= 5 ? 5 : factor >= 2 ? 2 : 1);
  }

  private static void paintPath(
      Graphics2D map, List<Sample> samples, double centreX, double centreY, double pixelsPerMetre) {
    map.setStroke(new BasicStroke(2));
    Sample newest = samples.get(samples.size() - 1);
    for (int i = 1; i < samples.size(); ++i) {
      double[] from = samples.get(i - 1).position();
      double[] to = samples.get(i).position();
      double freshness = 1 + CapsuleHistory.age(samples.get(i), newest) / CapsuleHistory.SECONDS;
      map.setColor(new Color(ColourScale.rgb(0.2 + 0.8 * freshness)));
      // Java 2D leaves out what is not a number.
      map.draw(new Line2D.Double((from[0] - centreX) * pixelsPerMetre,
          -(from[1] - centreY) * pixelsPerMetre, (to[0] - centreX) * pixelsPerMetre,
          -(to[1] - centreY) * pixelsPerMetre));
    }
  }

  private static void paintCapsule(
      Graphics2D map, Sample now, double centreX, double centreY, double pixelsPerMetre) {
    double x = (now.position()[0] - centreX) * pixelsPerMetre;
    double y = -(now.position()[1] - centreY) * pixelsPerMetre;
    double sigmaX = now.sigma()[0] * pixelsPerMetre;
    double sigmaY = now.sigma()[1] * pixelsPerMetre;
    map.setColor(Theme.transparent(Theme.TEXT, 70));
    map.fill(new Ellipse2D.Double(x - sigmaX, y - sigmaY, 2 * sigmaX, 2 * sigmaY));
    map.setColor(Theme.TEXT);
    map.fill(new Ellipse2D.Double(x - 4, y - 4, 8, 8));
    map.draw(new Line2D.Double(x, y, x + HEADING * now.axis()[0], y - HEADING * now.axis()[1]));
  }
}
