package gastronaut.spy;

import java.awt.Color;
import java.awt.Font;

/** The views' colours and type. */
final class Theme {
  static final Color BACKGROUND = new Color(0x1e1f22);
  static final Color FIELD = new Color(0x2a2c30);
  static final Color GRID = new Color(0x44474d);
  static final Color TEXT = new Color(0xe6e6e6);
  static final Color FAINT = new Color(0x9a9da3);
  static final Color GOOD = new Color(0x5fbf77);
  static final Color FAIR = new Color(0xe8b341);
  static final Color BAD = new Color(0xf0655a);
  static final Color FIRST = new Color(0x6fb1ff);
  static final Color SECOND = new Color(0xffa45c);
  static final Color THIRD = new Color(0xb48cff);
  static final Font FONT = new Font(Font.SANS_SERIF, Font.PLAIN, 13);
  static final Font SMALL = new Font(Font.SANS_SERIF, Font.PLAIN, 10);

  private Theme() {}

  static Color transparent(Color colour, int alpha) {
    return new Color(colour.getRed(), colour.getGreen(), colour.getBlue(), alpha);
  }
}
