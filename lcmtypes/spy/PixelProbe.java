package gastronaut.spy;

import java.awt.Graphics2D;
import java.awt.Image;
import java.awt.Point;
import java.awt.Rectangle;
import java.awt.RenderingHints;
import java.awt.event.MouseAdapter;
import java.awt.event.MouseEvent;
import java.awt.image.BufferedImage;
import javax.swing.JComponent;

/** Paints a picture at the largest size that fits, and knows which pixel is under the mouse. */
final class PixelProbe extends MouseAdapter {
  private final JComponent component;
  private Rectangle place = new Rectangle();  // of the picture, in the component
  private Point mouse;

  PixelProbe(JComponent component) {
    this.component = component;
    component.addMouseMotionListener(this);
    component.addMouseListener(this);
  }

  void paint(Graphics2D graphics, Image picture, int width, int height) {
    int columns = picture.getWidth(null);
    int rows = picture.getHeight(null);
    double scale = Math.min((double) width / columns, (double) height / rows);
    int shownWidth = (int) Math.max(1, Math.round(scale * columns));
    int shownHeight = (int) Math.max(1, Math.round(scale * rows));
    int left = (width - shownWidth) / 2;
    graphics.setRenderingHint(RenderingHints.KEY_INTERPOLATION,
        scale < 1 ? RenderingHints.VALUE_INTERPOLATION_BILINEAR
                  : RenderingHints.VALUE_INTERPOLATION_NEAREST_NEIGHBOR);
    graphics.drawImage(picture, left, 0, shownWidth, shownHeight, null);
    place = new Rectangle(left + (int) graphics.getTransform().getTranslateX(),
        (int) graphics.getTransform().getTranslateY(), shownWidth, shownHeight);
  }

  /** The picture's pixel under the mouse, null when it is elsewhere. */
  Point pixel(BufferedImage picture) {
    if (mouse == null || !place.contains(mouse)) return null;
    return new Point((mouse.x - place.x) * picture.getWidth() / place.width,
        (mouse.y - place.y) * picture.getHeight() / place.height);
  }

  @Override
  public void mouseMoved(MouseEvent event) {
    mouse = event.getPoint();
    component.repaint();
  }

  @Override
  public void mouseExited(MouseEvent event) {
    mouse = null;
    component.repaint();
  }
}
