package gastronaut.spy;

import java.awt.Color;
import java.awt.FontMetrics;
import java.awt.Graphics2D;

/**
 * Dark violet over blue and green to yellow, even to the eye and readable without colour vision.
 */
final class ColourScale {
  static final int BAR_WIDTH = 76;  // pixels, with its labels

  private static final int[] ANCHORS = {0x440154, 0x3b528b, 0x21918c, 0x5ec962, 0xfde725};
  private static final int BAR_STEPS = 256;
  private static final int LABELS = 5;

  private ColourScale() {}

  /** The packed RGB colour of a fraction 0..1 of the range; what lies outside takes the end's. */
  static int rgb(double fraction) {
    double place = Math.max(0, Math.min(1, fraction)) * (ANCHORS.length - 1);
    int below = Math.min((int) place, ANCHORS.length - 2);
    double weight = place - below;
    int colour = 0;
    for (int shift = 16; shift >= 0; shift -= 8) {
      int from = ANCHORS[below] >> shift & 0xff;
      int to = ANCHORS[below + 1] >> shift & 0xff;
      colour |= (int) Math.round(from + weight * (to - from)) << shift;
    }
    return colour;
  }

  /** A vertical bar with its numbers; topFraction: the colour at its top, the other end below. */
  static void paintBar(Graphics2D graphics, int left, int top, int height, double bottomValue,
      double topValue, double topFraction, String unit) {
    int width = 16;
    for (int step = 0; step < BAR_STEPS; ++step) {
      double up = (step + 0.5) / BAR_STEPS;
      graphics.setColor(new Color(rgb(topFraction * up + (1 - topFraction) * (1 - up))));
      int upper = top + (BAR_STEPS - 1 - step) * height / BAR_STEPS;
      int lower = top + (BAR_STEPS - step) * height / BAR_STEPS;
      graphics.fillRect(left, upper, width, lower - upper);
    }
    graphics.setColor(Theme.TEXT);
    graphics.setFont(Theme.SMALL);
    FontMetrics metrics = graphics.getFontMetrics();
    for (int label = 0; label < LABELS; ++label) {
      double up = label / (LABELS - 1.0);
      double value = bottomValue + up * (topValue - bottomValue);
      double baseline = top + (1 - up) * (height - metrics.getAscent()) + metrics.getAscent() - 1;
      graphics.drawString(Text.threeDigits(value) + " " + unit, left + width + 4, (float) baseline);
    }
  }
}
