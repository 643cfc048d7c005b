package gastronaut.spy;

/** Numbers and times as the views write them. */
final class Text {
  private Text() {}

  static String threeDigits(double value) {
    double size = Math.abs(value);
    if (!Double.isFinite(value)) return "?";
    if (size >= 99.95 || size == 0) return String.format("%.0f", value);
    return String.format(size >= 9.995 ? "%.1f" : "%.2f", value);
  }

  /** At most so many characters; decimals are rounded to three digits. */
  static String shortened(String value, int length) {
    if (value.matches("-?\\d{1,12}\\.\\d{1,40}")) return threeDigits(Double.parseDouble(value));
    return value.length() <= length ? value : value.substring(0, length) + "...";
  }
}
