//! How odometry drifts, how fixes err, and when to doubt.

/// How a [`Filter`](super::Filter) models, gates and remembers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FilterConfig {
    /// How odometry errs.
    pub odometry: OdometryNoise,
    /// How fixes err together.
    pub fixes: FixNoise,
    /// A fix whose normalised innovation squared exceeds this is not used. Three degrees of
    /// freedom: 16.27 turns one good fix in a thousand away.
    pub gate_nis: f64,
    /// When fixes that agree with each other overrule the filter, or start it.
    pub recovery: Recovery,
    /// How far back a fix is taken into account, seconds: how late it may come, and the half batch
    /// before its time. Costs about 1 kB for each odometry pose.
    pub history_s: f64,
    /// Odometry poses closer together than this are not stored one by one, seconds: it bounds memory
    /// and work, whatever the odometry's rate.
    pub spacing_s: f64,
    /// Odometry that moves faster than this has jumped, metres per second.
    pub max_speed_mps: f64,
}

impl Default for FilterConfig {
    fn default() -> Self {
        Self {
            odometry: OdometryNoise::default(),
            fixes: FixNoise::default(),
            gate_nis: 16.27,
            recovery: Recovery::default(),
            history_s: 10.0,
            spacing_s: 0.02,
            max_speed_mps: 100.0,
        }
    }
}

/// One-sigma errors of odometry increments.
///
/// Scale and yaw rate err by Gauss-Markov processes: the sigma is what is believed before the first
/// fix, and the time constant how fast what was learnt goes stale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryNoise {
    /// Fraction by which distances are wrong.
    pub scale: f64,
    /// Time over which the scale error changes, seconds.
    pub scale_time_s: f64,
    /// Error of the yaw rate, radians per second.
    pub yaw_rate_radps: f64,
    /// Time over which the error of the yaw rate changes, seconds.
    pub yaw_rate_time_s: f64,
    /// Random walk of the position, metres per square root of a metre driven.
    pub walk_m: f64,
    /// Random walk of the yaw, radians per square root of a second.
    pub walk_rad: f64,
}

impl Default for OdometryNoise {
    /// Wheel odometry with an automotive gyro: 0.5 %, 0.02 degrees a second, both steady over half
    /// an hour.
    fn default() -> Self {
        Self {
            scale: 0.005,
            scale_time_s: 1800.0,
            yaw_rate_radps: 0.02_f64.to_radians(),
            yaw_rate_time_s: 1800.0,
            walk_m: 0.005,
            walk_rad: 0.02_f64.to_radians(),
        }
    }
}

/// What the errors of neighbouring fixes have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FixNoise {
    /// The part of a fix's position error that is the map's own: one sigma along each axis, metres.
    pub map_m: f64,
    /// The same of the heading, radians.
    pub map_rad: f64,
    /// Way over which the map's own error changes, metres.
    pub map_way_m: f64,
    /// What a batch spans, seconds: fixes closer together share detections.
    pub batch_s: f64,
    /// How far back into its batch a fix measures, as a fraction of `batch_s`; 0 for fixes of a single
    /// scan. See [the model](super#a-fix-is-for-the-middle-of-its-batch).
    pub middle: f64,
}

impl Default for FixNoise {
    /// A map of few contributors, batches of 5 s.
    fn default() -> Self {
        Self { map_m: 0.1, map_rad: 0.001, map_way_m: 50.0, batch_s: 5.0, middle: 0.5 }
    }
}

/// When fixes that agree with each other are believed rather than the filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recovery {
    /// Consecutive fixes that must agree, to start and to overrule.
    pub agreeing: usize,
    /// To overrule, they must span this, seconds. Longer than a batch, whose fixes err alike, and
    /// longer than it takes to pass a row of parked cars that looks the same one car further on.
    pub span_s: f64,
    /// A fix that waits longer than this for others to agree is forgotten, seconds.
    pub within_s: f64,
}

impl Default for Recovery {
    fn default() -> Self {
        Self { agreeing: 3, span_s: 10.0, within_s: 20.0 }
    }
}
