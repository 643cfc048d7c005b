package gastronaut.spy;

import java.awt.BasicStroke;
import java.awt.Color;
import java.awt.FontMetrics;
import java.awt.Graphics2D;
import java.awt.geom.Ellipse2D;
import java.awt.geom.Line2D;
import java.awt.geom.Path2D;

/** Paints one sensor of the array: magnitude, direction and number, or why it is not used. */
final class HallCell {
  private static final double ARROW_LENGTH = 0.42;  // of the cell

  private HallCell() {}

  static void paint(
      Graphics2D graphics, HallReading field, int sensor, double left, double top, double cell) {
    int x = (int) left;
    int y = (int) top;
    int size = (int) (left + cell) - x - 1;
    int sizeDown = (int) (top + cell) - y - 1;
    String cause = field.cause(sensor);
    graphics.setFont(Theme.SMALL);
    FontMetrics metrics = graphics.getFontMetrics();
    boolean roomForText = cell > 3.2 * metrics.getHeight();
    if (!cause.isEmpty()) {
      paintUnused(graphics, cause, x, y, size, sizeDown);
    } else {
      double fraction = field.magnitude(sensor) / field.strongest();
      graphics.setColor(new Color(ColourScale.rgb(fraction)));
      graphics.fillRect(x, y, size, sizeDown);
      graphics.setColor(fraction > 0.6 ? Color.BLACK : Color.WHITE);
      paintDirection(graphics, field.direction(sensor), left + cell / 2, top + cell / 2, cell);
      if (roomForText) {
        String value = Text.threeDigits(HallArrayPanel.MICROTESLA * field.magnitude(sensor));
        graphics.drawString(value, x + size - metrics.stringWidth(value) - 3, y + sizeDown - 4);
      }
    }
    if (roomForText) {
      graphics.drawString(Integer.toString(sensor), x + 3, y + metrics.getAscent() + 1);
    }
  }

  private static void paintUnused(
      Graphics2D graphics, String cause, int x, int y, int width, int height) {
    graphics.setColor(Theme.FIELD);
    graphics.fillRect(x, y, width, height);
    graphics.setColor(Theme.BAD);
    graphics.setStroke(new BasicStroke(1.5f));
    graphics.drawRect(x + 1, y + 1, width - 3, height - 3);
    int text = graphics.getFontMetrics().stringWidth(cause);
    graphics.drawString(cause, x + (width - text) / 2, y + height / 2 + 4);
  }

  /** The part in the array's plane as an arrow; the rest as a dot (to the reader) or a cross. */
  private static void paintDirection(
      Graphics2D graphics, double[] unit, double x, double y, double cell) {
    double across = unit.length == 3 ? unit[2] : unit[0];
    double radius = 0.07 * cell;
    graphics.setStroke(new BasicStroke((float) Math.max(1, 0.025 * cell)));
    if (unit.length == 3) {
      double dx = ARROW_LENGTH * cell * unit[0];
      double dy = -ARROW_LENGTH * cell * unit[1];
      graphics.draw(new Line2D.Double(x, y, x + dx, y + dy));
      double length = Math.hypot(dx, dy);
      if (length > 1.5 * radius)
        paintArrowHead(graphics, x + dx, y + dy, dx / length, dy / length, radius);
    }
    graphics.draw(new Ellipse2D.Double(x - radius, y - radius, 2 * radius, 2 * radius));
    double mark = radius * Math.abs(across);
    if (across > 0) {
      graphics.fill(new Ellipse2D.Double(x - mark, y - mark, 2 * mark, 2 * mark));
    } else {
      mark *= Math.sqrt(0.5);
      graphics.draw(new Line2D.Double(x - mark, y - mark, x + mark, y + mark));
      graphics.draw(new Line2D.Double(x - mark, y + mark, x + mark, y - mark));
    }
  }

  private static void paintArrowHead(
      Graphics2D graphics, double x, double y, double dx, double dy, double size) {
    Path2D head = new Path2D.Double();
    head.moveTo(x, y);
    head.lineTo(x - size * (1.6 * dx + 0.7 * dy), y - size * (1.6 * dy - 0.7 * dx));
    head.lineTo(x - size * (1.6 * dx - 0.7 * dy), y - size * (1.6 * dy + 0.7 * dx));
    head.closePath();
    graphics.fill(head);
  }
}
