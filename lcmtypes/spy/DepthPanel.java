package gastronaut.spy;

import gastronaut.depth_image_t;
import java.awt.Dimension;
import java.awt.Graphics2D;
import java.awt.Point;
import java.awt.image.BufferedImage;
import java.io.IOException;
import java.util.Arrays;

/**
 * Depth as colours, near yellow and far violet, none grey, with their scale and the depth under
 * the mouse.
 */
public final class DepthPanel extends MessagePanel {
  // The scale leaves out a few wild pixels and follows the scene slowly, so that colours can be
  // compared from frame to frame.
  private static final double OUTSIDE_FRACTION = 0.01;
  private static final double FOLLOW = 0.1;
  private static final double MILLIMETRES = 1e3;
  private static final int NO_DEPTH = 0x808080;  // not on the colour scale

  private record View(
      BufferedImage picture, float[] depth, double near, double far, String summary) {}

  private final PixelProbe probe = new PixelProbe(this);
  private volatile View view;

  public DepthPanel(String channel) {
    super(channel, 1, new Dimension(464, 336));
  }

  @Override
  protected void decode(byte[] bytes) throws IOException {
    depth_image_t message = new depth_image_t(bytes);
    float[] depth = DepthDecoder.decode(message);
    float[] sorted = withoutHoles(depth);
    double[] range = followRange(sorted);
    double filled = 100.0 * sorted.length / depth.length;
    String summary = String.format("%d x %d   \u03c3 %s %%   %.0f %% of the pixels", message.width,
        message.height, Text.threeDigits(100 * message.relative_std), filled);
    view = new View(colours(depth, message.width, message.height, range[0], range[1]), depth,
        range[0], range[1], summary);
  }

  @Override
  protected String summary() {
    View shown = view;
    return shown == null ? "" : shown.summary() + "   " + depthUnderMouse(shown);
  }

  @Override
  protected void paintView(Graphics2D graphics, int width, int height) {
    View shown = view;
    if (shown == null) return;
    probe.paint(graphics, shown.picture(), Math.max(1, width - ColourScale.BAR_WIDTH), height);
    ColourScale.paintBar(graphics, width - ColourScale.BAR_WIDTH + 8, 0, height,
        MILLIMETRES * shown.far(), MILLIMETRES * shown.near(), 1, "mm");
  }

  private String depthUnderMouse(View shown) {
    Point pixel = probe.pixel(shown.picture());
    if (pixel == null) return "";
    float metres = shown.depth()[pixel.y * shown.picture().getWidth() + pixel.x];
    return String.format(
        "(%d, %d): %s mm", pixel.x, pixel.y, Text.threeDigits(MILLIMETRES * metres));
  }

  private static float[] withoutHoles(float[] depth) {
    float[] sorted = depth.clone();
    Arrays.sort(sorted);  // NaN last
    int end = sorted.length;
    while (end > 0 && Float.isNaN(sorted[end - 1])) --end;
    return Arrays.copyOf(sorted, end);
  }

  private double[] followRange(float[] sorted) {
    View last = view;
    if (sorted.length == 0) {
      return last == null ? new double[] {0, 1} : new double[] {last.near(), last.far()};
    }
    int outside = (int) (OUTSIDE_FRACTION * sorted.length);
    double near = sorted[outside];
    double far = sorted[sorted.length - 1 - outside];
    if (last == null) return new double[] {near, far};
    return new double[] {
        last.near() + FOLLOW * (near - last.near()), last.far() + FOLLOW * (far - last.far())};
  }

  private static BufferedImage colours(
      float[] depth, int width, int height, double near, double far) {
    double span = far > near ? far - near : 1;  // a wall seen straight on has one depth
    int[] pixels = new int[depth.length];
    for (int i = 0; i < depth.length; ++i) {
      pixels[i] = Float.isNaN(depth[i]) ? NO_DEPTH : ColourScale.rgb((far - depth[i]) / span);
    }
    BufferedImage picture = new BufferedImage(width, height, BufferedImage.TYPE_INT_RGB);
    picture.setRGB(0, 0, width, height, pixels, 0, width);
    return picture;
  }
}
