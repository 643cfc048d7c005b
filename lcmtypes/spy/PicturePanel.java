package gastronaut.spy;

import gastronaut.image_metadata_t;
import gastronaut.image_t;
import java.awt.Dimension;
import java.awt.FontMetrics;
import java.awt.Graphics2D;
import java.awt.Point;
import java.awt.image.BufferedImage;
import java.io.IOException;
import java.nio.charset.StandardCharsets;

/** Pictures as large as the window allows, with their metadata and the value under the mouse. */
public final class PicturePanel extends MessagePanel {
  private static final int MAX_METADATA = 12;
  private static final int MAX_VALUE = 24;  // characters of a metadata value

  private record View(BufferedImage picture, String metadata) {}

  private final PixelProbe probe = new PixelProbe(this);
  private volatile View view;

  public PicturePanel(String channel) {
    super(channel, 1, new Dimension(400, 340));
  }

  @Override
  protected void decode(byte[] bytes) throws IOException {
    image_t message = new image_t(bytes);
    BufferedImage picture = PictureDecoder.decode(message);
    view = new View(picture, metadata(message));
  }

  @Override
  protected String summary() {
    View shown = view;
    if (shown == null) return "";
    BufferedImage picture = shown.picture();
    return picture.getWidth() + " x " + picture.getHeight() + "   " + valueUnderMouse(picture);
  }

  @Override
  protected void paintView(Graphics2D graphics, int width, int height) {
    View shown = view;
    if (shown == null) return;
    graphics.setFont(Theme.SMALL);
    FontMetrics metrics = graphics.getFontMetrics();
    graphics.setColor(Theme.FAINT);
    graphics.drawString(shown.metadata(), 0, height - metrics.getDescent());
    probe.paint(graphics, shown.picture(), width, Math.max(1, height - metrics.getHeight() - 2));
  }

  private String valueUnderMouse(BufferedImage picture) {
    Point pixel = probe.pixel(picture);
    if (pixel == null) return "";
    int rgb = picture.getRGB(pixel.x, pixel.y);
    return String.format(
        "(%d, %d): %d %d %d", pixel.x, pixel.y, rgb >> 16 & 0xff, rgb >> 8 & 0xff, rgb & 0xff);
  }

  private static String metadata(image_t message) {
    StringBuilder text = new StringBuilder();
    for (int i = 0; i < Math.min(message.nmetadata, MAX_METADATA); ++i) {
      image_metadata_t entry = message.metadata[i];
      String value = Text.shortened(new String(entry.value, StandardCharsets.UTF_8), MAX_VALUE);
      text.append(entry.key).append(' ').append(value).append("   ");
    }
    return text.toString();
  }
}
