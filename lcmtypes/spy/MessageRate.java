package gastronaut.spy;

/** Counts messages and says how many come in a second, or for how long none has come. */
final class MessageRate {
  private static final double SILENCE = 2;  // seconds; every channel that has a view is at 1 Hz up
  private static final double WINDOW = 1;  // seconds

  private long count = 0;
  private double lastArrival;
  private double windowStart;
  private long windowCount = 0;
  private double rate = Double.NaN;

  synchronized void arrived() {
    double now = seconds();
    if (count == 0) windowStart = now;
    ++count;
    ++windowCount;
    lastArrival = now;
    if (now - windowStart < WINDOW) return;
    rate = (windowCount - 1) / (now - windowStart);
    windowStart = now;
    windowCount = 1;
  }

  synchronized long count() {
    return count;
  }

  synchronized boolean isSilent() {
    return count > 0 && seconds() - lastArrival > SILENCE;
  }

  synchronized String text() {
    if (count == 0) return "";
    if (isSilent()) return String.format("no message for %.0f s", seconds() - lastArrival);
    return Double.isNaN(rate) ? "" : String.format("%.1f Hz", rate);
  }

  private static double seconds() {
    return System.nanoTime() * 1e-9;
  }
}
