//! A seeded ten-minute drive through a town: truth, odometry that drifts, fixes that err as real
//! ones do.

use std::error::Error;

use echofix_client::filter::{FilterConfig, FixMeasurement, PriorSource};
use echofix_core::drive::GeoPose;
use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::compare::Comparison;

/// Microseconds since the Unix epoch at which a drive starts.
const START_US: i64 = 1_700_000_000_000_000;
const START: LatLon = LatLon { lat_deg: 30.2672, lon_deg: -97.7431 };
/// Odometry poses come this often, seconds.
const TICK_S: f64 = 0.05;
const TICKS_PER_S: usize = 20;
const MINUTES: usize = 10;

/// Fraction of odometry's scale error, one sigma of a drive.
const SCALE: f64 = 0.005;
const YAW_DRIFT_RADPS: f64 = 0.02 * DEGREE;
/// Random walks: metres a square root of a metre, radians a square root of a second.
const WALK_M: f64 = 0.005;
const WALK_RAD: f64 = 0.02 * DEGREE;

/// The map's own error along each axis, and the way over which it changes, metres.
const MAP_M: f64 = 0.1;
const MAP_WAY_M: f64 = 50.0;
/// What a batch adds, metres and radians; batches of `BATCH_S` seconds share what they overlap.
const BATCH_M: f64 = 0.08;
const BATCH_RAD: f64 = 0.1 * DEGREE;
const BATCH_S: usize = 5;

const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// A fix and when the vehicle gets it.
pub struct Arrival {
    pub arrives_us: i64,
    pub fix: FixMeasurement,
}

/// One drive.
pub struct SimulatedDrive {
    /// One pose a tick.
    pub truth: Vec<GeoPose>,
    /// Of the same times.
    pub odometry: Trajectory,
    /// By arrival, not by the time they are for.
    pub fixes: Vec<Arrival>,
}

/// The drive of a seed, with fixes that measure this far back into their batch, as a fraction of it
/// (`FixNoise::middle`).
pub fn drive(seed: u64, middle: f64) -> Result<SimulatedDrive, Box<dyn Error>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let truth = integrated(&motion(&mut rng));
    let odometry = odometry(&truth, &mut rng);
    let fixes = fixes(&truth, &odometry, middle, &mut rng)?;
    let town = Town::new()?;
    let truth = truth.iter().map(|at| town.geodetic(at)).collect::<Result<_, _>>()?;
    Ok(SimulatedDrive { truth, odometry: Trajectory::new(odometry)?, fixes })
}

impl SimulatedDrive {
    /// Drives it, judged five times a second from the filter's first estimate on.
    pub fn compare(&self, config: FilterConfig) -> Result<Comparison, Box<dyn Error>> {
        let mut comparison = Comparison::new(config);
        let mut fixes = self.fixes.iter().peekable();
        for (tick, ((time_us, odometry), truth)) in self.odometry.iter().zip(&self.truth).enumerate() {
            comparison.push_odometry(time_us, odometry)?;
            while let Some(arrival) = fixes.next_if(|arrival| arrival.arrives_us <= time_us) {
                let then = self.odometry.at(arrival.fix.time_us).ok_or("a fix before the drive")?;
                comparison.push_fix(&arrival.fix, then)?;
            }
            if tick % 4 == 0 {
                comparison.judge(truth, &odometry)?;
            }
        }
        Ok(comparison)
    }
}

/// Ground metres around the start, x towards grid east.
struct Town {
    grid: Grid,
    origin: MapPoint,
    scale: f64,
}

impl Town {
    fn new() -> Result<Self, geo::Error> {
        let grid = Grid::of(START)?;
        let (origin, scale) = (grid.project(START)?, grid.scale_factor(START)?);
        Ok(Self { grid, origin, scale })
    }

    fn geodetic(&self, (time_us, pose): &(i64, Pose2)) -> Result<GeoPose, geo::Error> {
        let MapPoint { x_m, y_m } = self.origin.moved(self.scale * pose.x_m, self.scale * pose.y_m);
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&Pose2::new(x_m, y_m, pose.yaw_rad))?;
        Ok(GeoPose { time_us: *time_us, at, yaw_rad, ..GeoPose::default() })
    }
}

/// (speed, yaw rate) at each tick: blocks, turns at their ends, stops before some.
fn motion(rng: &mut ChaCha8Rng) -> Vec<(f64, f64)> {
    let (brake_mps2, ticks) = (1.6, 60 * MINUTES * TICKS_PER_S);
    let (mut moves, mut speed_mps) = (Vec::with_capacity(ticks), 0.0_f64);
    while moves.len() < ticks {
        let (block_m, cruise_mps) = (rng.random_range(60.0..180.0), rng.random_range(8.0..12.5));
        let (radius_m, stops) = (rng.random_range(8.0..14.0_f64), rng.random_bool(0.35));
        let turn_mps = if stops { 0.0 } else { (2.0 * radius_m).sqrt() };
        let mut way_m = 0.0;
        while way_m < block_m {
            let braking_mps = (turn_mps * turn_mps + 2.0 * brake_mps2 * (block_m - way_m)).sqrt();
            speed_mps = (speed_mps + brake_mps2 * TICK_S).min(cruise_mps).min(braking_mps).max(0.3);
            way_m += speed_mps * TICK_S;
            moves.push((speed_mps, 0.0));
        }
        if stops {
            speed_mps = 0.0;
            moves.extend(vec![(0.0, 0.0); rng.random_range(2..12) * TICKS_PER_S]);
        }
        let sense = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let mut turned_rad = 0.0;
        while turned_rad < 90.0 * DEGREE {
            speed_mps = (speed_mps + brake_mps2 * TICK_S).min((2.0 * radius_m).sqrt());
            turned_rad += speed_mps / radius_m * TICK_S;
            moves.push((speed_mps, sense * speed_mps / radius_m));
        }
    }
    moves.truncate(ticks);
    moves
}

fn integrated(moves: &[(f64, f64)]) -> Vec<(i64, Pose2)> {
    let mut pose = Pose2::new(0.0, 0.0, 0.4);
    let mut truth = vec![(START_US, pose)];
    for (tick, (speed_mps, yaw_rate_radps)) in moves.iter().enumerate() {
        pose = pose.compose(&Pose2::new(speed_mps * TICK_S, 0.0, yaw_rate_radps * TICK_S));
        truth.push((START_US + (tick as i64 + 1) * 50_000, pose));
    }
    truth
}

fn odometry(truth: &[(i64, Pose2)], rng: &mut ChaCha8Rng) -> Vec<(i64, Pose2)> {
    let (scale, drift_radps) = (1.0 + normal(rng, SCALE), normal(rng, YAW_DRIFT_RADPS));
    let mut pose = Pose2::IDENTITY;
    let mut poses = vec![(START_US, pose)];
    for pair in truth.windows(2) {
        let step = pair[0].1.between(&pair[1].1);
        let walk_m = WALK_M * step.x_m.hypot(step.y_m).sqrt();
        pose = pose.compose(&Pose2::new(
            scale * step.x_m + normal(rng, walk_m),
            scale * step.y_m + normal(rng, walk_m),
            step.yaw_rad + drift_radps * TICK_S + normal(rng, WALK_RAD * TICK_S.sqrt()),
        ));
        poses.push((pair[1].0, pose));
    }
    poses
}

/// How fixes err, as it goes on.
struct FixErrors {
    map: [f64; 2],
    /// Of the seconds a batch spans: its error is their mean.
    seconds: [[f64; 3]; BATCH_S],
}

impl FixErrors {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        Self {
            map: [normal(rng, MAP_M), normal(rng, MAP_M)],
            seconds: [(); BATCH_S].map(|()| Self::second(rng)),
        }
    }

    fn second(rng: &mut ChaCha8Rng) -> [f64; 3] {
        [BATCH_M, BATCH_M, BATCH_RAD].map(|sigma| normal(rng, (BATCH_S as f64).sqrt() * sigma))
    }

    /// A second and some metres later.
    fn after(&mut self, way_m: f64, rng: &mut ChaCha8Rng) {
        let left = (-way_m / MAP_WAY_M).exp();
        self.map = self.map.map(|error_m| left * error_m + normal(rng, MAP_M * (1.0 - left * left).sqrt()));
        self.seconds.rotate_left(1);
        self.seconds[BATCH_S - 1] = Self::second(rng);
    }

    /// A pose as a batch sees it.
    fn seen(&self, pose: &Pose2) -> Pose2 {
        let [x, y, yaw] = [0, 1, 2].map(|i| self.seconds.iter().map(|s| s[i]).sum::<f64>() / BATCH_S as f64);
        Pose2::new(pose.x_m + self.map[0] + x, pose.y_m + self.map[1] + y, pose.yaw_rad + yaw)
    }
}

/// A fix a second while the vehicle drives: 20 % are lost, 10 % late by 0.5 to 4 s, 2 % wrong by 2 to
/// 8 m, and none says so.
fn fixes(
    truth: &[(i64, Pose2)],
    odometry: &[(i64, Pose2)],
    middle: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Arrival>, geo::Error> {
    let (town, mut errors, mut fixes) = (Town::new()?, FixErrors::new(rng), Vec::new());
    for end in (TICKS_PER_S..truth.len()).step_by(TICKS_PER_S) {
        let way_m: f64 = truth[end - TICKS_PER_S..=end].windows(2).map(|w| w[0].1.distance_m(&w[1].1)).sum();
        errors.after(way_m, rng);
        // What the middle of the batch measures is carried to its end by odometry, errors and all.
        let back = (middle * (BATCH_S * TICKS_PER_S).min(end) as f64) as usize;
        let carried = odometry[end - back].1.between(&odometry[end].1);
        let seen = errors.seen(&truth[end - back].1);
        let mut answer = seen.compose(&carried);
        let covariance = covariance_at_end(&seen, &answer);
        if rng.random_bool(0.02) {
            let direction = Pose2::new(answer.x_m, answer.y_m, rng.random_range(-3.1..3.1));
            [answer.x_m, answer.y_m] = direction.transform([rng.random_range(2.0..8.0), 0.0]);
        }
        let late_s = if rng.random_bool(0.1) { rng.random_range(0.5..4.0) } else { 0.0 };
        if rng.random_bool(0.2) || way_m < 1.0 {
            continue;
        }
        let GeoPose { time_us, at, yaw_rad, .. } = town.geodetic(&(truth[end].0, answer))?;
        let prior = PriorSource::Own;
        let fix = FixMeasurement { time_us, at, yaw_rad, covariance, contains_prior: false, prior };
        fixes.push(Arrival { arrives_us: time_us + ((0.3 + late_s) * 1e6) as i64, fix });
    }
    fixes.sort_by_key(|arrival| arrival.arrives_us);
    Ok(fixes)
}

/// Covariance of the pose at the end of a batch (upper triangle): the heading's error at its middle
/// swings the way.
fn covariance_at_end(middle: &Pose2, end: &Pose2) -> [f64; 6] {
    let (x_m, y_m) = (end.x_m - middle.x_m, end.y_m - middle.y_m);
    let (position, yaw) = (MAP_M.powi(2) + BATCH_M.powi(2), BATCH_RAD.powi(2));
    let (xx, yy) = (position + y_m * y_m * yaw, position + x_m * x_m * yaw);
    [xx, -x_m * y_m * yaw, -y_m * yaw, yy, x_m * yaw, yaw]
}

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let unit: f64 = rng.sample(StandardNormal);
    sigma * unit
}
