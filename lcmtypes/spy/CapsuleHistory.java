package gastronaut.spy;

import gastronaut.capsule_state_t;
import gastronaut.sensor_health_t;
import java.util.ArrayList;
import java.util.List;

/** The last 60 s of the capsule's state, one sample each tenth of a second of message time. */
final class CapsuleHistory {
  static final double SECONDS = 60;
  static final int MAX_SENSORS = 4;

  private static final long STEP_MICROSECONDS = 100_000;
  private static final long STEPS = (long) (SECONDS * 1e6) / STEP_MICROSECONDS;

  /** One sensor's health; cause is empty when nominal. */
  record Health(String name, double nominal, double alpha, boolean used, String cause) {}

  /** Metres; sigma is one standard deviation; axis is the optical axis in the rig frame. */
  record Sample(long step, int status, double[] position, double[] sigma, double[] axis,
      double speed, double depthScale, List<Health> sensors) {}

  private final List<Sample> samples = new ArrayList<>();

  /** A state from before the last one, or long after it, starts the history again. */
  synchronized void add(capsule_state_t state) {
    Sample sample = sample(state);
    if (!samples.isEmpty()) {
      long step = samples.get(samples.size() - 1).step();
      if (sample.step() < step || sample.step() - step > STEPS) samples.clear();
      if (sample.step() == step) {
        sample = withTroubleOf(samples.remove(samples.size() - 1), sample);
      }
    }
    samples.add(sample);
    while (samples.get(0).step() < sample.step() - STEPS) samples.remove(0);
  }

  /** Oldest first. */
  synchronized List<Sample> samples() {
    return List.copyOf(samples);
  }

  /** Seconds before the newest sample, negative. */
  static double age(Sample sample, Sample newest) {
    return (sample.step() - newest.step()) * STEP_MICROSECONDS * 1e-6;
  }

  private static Sample sample(capsule_state_t state) {
    double[] sigma = new double[3];
    for (int i = 0; i < 3; ++i) sigma[i] = Math.sqrt(state.covariance[i][i]);
    List<Health> sensors = new ArrayList<>();
    for (int i = 0; i < Math.min(state.num_sensors, MAX_SENSORS); ++i) {
      sensor_health_t health = state.sensors[i];
      sensors.add(
          new Health(health.name, health.p_nominal, health.alpha, health.used, health.cause));
    }
    double[] v = state.velocity;
    return new Sample(Math.floorDiv(state.utime, STEP_MICROSECONDS), state.status, state.position,
        sigma, opticalAxis(state.orientation), Math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]),
        state.depth_scale, List.copyOf(sensors));
  }

  /** Third column of the rotation matrix of a unit quaternion w, x, y, z. */
  private static double[] opticalAxis(double[] q) {
    return new double[] {2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]),
        1 - 2 * (q[1] * q[1] + q[2] * q[2])};
  }

  /** The newer sample; a sensor's trouble stays visible though it lasted less than a step. */
  private static Sample withTroubleOf(Sample older, Sample newer) {
    List<Health> sensors = new ArrayList<>();
    for (int i = 0; i < newer.sensors().size(); ++i) {
      Health now = newer.sensors().get(i);
      Health before = i < older.sensors().size() ? older.sensors().get(i) : now;
      boolean trouble = now.cause().isEmpty() && !before.cause().isEmpty();
      sensors.add(trouble ? before : now);
    }
    return new Sample(newer.step(), newer.status(), newer.position(), newer.sigma(), newer.axis(),
        newer.speed(), newer.depthScale(), List.copyOf(sensors));
  }
}
