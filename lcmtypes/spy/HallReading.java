package gastronaut.spy;

import gastronaut.hall_array_t;

/** One reading of the array, less another that is taken as zero. */
final class HallReading {
  private final hall_array_t reading;
  private final hall_array_t zero;  // null: none
  private final double strongest;

  HallReading(hall_array_t reading, hall_array_t zero) {
    this.reading = reading;
    boolean sameArray = zero != null && zero.num_sensors == reading.num_sensors
        && zero.num_axes == reading.num_axes;
    this.zero = sameArray ? zero : null;
    double largest = 0;
    for (int sensor = 0; sensor < sensors(); ++sensor) {
      if (cause(sensor).isEmpty()) largest = Math.max(largest, magnitude(sensor));
    }
    strongest = largest > 0 ? largest : Float.MIN_NORMAL;
  }

  int sensors() {
    return reading.num_sensors;
  }

  /** The largest magnitude of the sensors in use, tesla; above zero. */
  double strongest() {
    return strongest;
  }

  /** Tesla. */
  double magnitude(int sensor) {
    double sum = 0;
    for (int axis = 0; axis < reading.num_axes; ++axis) {
      double value = field(sensor, axis);
      sum += value * value;
    }
    return Math.sqrt(sum);
  }

  /** Unit vector in the sensor's own axes, zero where there is no field. */
  double[] direction(int sensor) {
    double[] unit = new double[reading.num_axes];
    double length = magnitude(sensor);
    if (length == 0) return unit;
    for (int axis = 0; axis < unit.length; ++axis) unit[axis] = field(sensor, axis) / length;
    return unit;
  }

  /** Why the sensor is not used; empty when it is. */
  String cause(int sensor) {
    int status = reading.status[sensor];
    if ((status & hall_array_t.STATUS_FAULT) != 0) return "fault";
    if ((status & hall_array_t.STATUS_STALE) != 0) return "stale";
    if ((status & hall_array_t.STATUS_SATURATED) != 0) return "saturated";
    if (status != hall_array_t.STATUS_OK) return "status " + status;
    if (!Double.isFinite(magnitude(sensor))) return "no value";
    return "";
  }

  private double field(int sensor, int axis) {
    double value = reading.field[sensor][axis];
    return zero == null ? value : value - zero.field[sensor][axis];
  }
}
