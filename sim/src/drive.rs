//! One drive of one vehicle along a route, with everything it records.

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::Grid;
use echofix_core::pose::Pose2;
use echofix_core::scan::Scan;

use crate::city::{CityDay, Mover};
use crate::error::{Error, within};
use crate::motion::{Motion, MotionParams, MotionState};
use crate::odometry::OdometryModel;
use crate::radar::{RadarSpec, Scanner};
use crate::reference::{PoseError, Wander};
use crate::rng::{Purpose, stream};
use crate::route::Route;
use crate::site::Site;

/// Who drives, when, with what.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveParams {
    /// Name of the vehicle.
    pub vehicle: String,
    /// Seed of everything that is not the city's: stops, detections, errors. Give every drive its own.
    pub seed: u64,
    /// Time at which the drive starts, microseconds since the Unix epoch (UTC).
    pub start_time_us: i64,
    /// Ends the drive after this many seconds, if the route has not ended before.
    pub max_duration_s: f64,
    /// The radars.
    pub radars: Vec<RadarSpec>,
    /// How the vehicle is driven.
    pub motion: MotionParams,
    /// Errors of the reference pose.
    pub pose_error: PoseError,
    /// Reference and truth poses per second.
    pub pose_rate_hz: f64,
    /// Errors of the odometry.
    pub odometry: OdometryModel,
    /// Odometry poses per second.
    pub odometry_rate_hz: f64,
}

impl Default for DriveParams {
    fn default() -> Self {
        Self {
            vehicle: "sim-1".to_owned(),
            seed: 1,
            // Thursday 9 May 2019, 15:00 UTC: the paper's mapping drive.
            start_time_us: 1_557_414_000_000_000,
            max_duration_s: f64::INFINITY,
            radars: RadarSpec::paper_set(),
            motion: MotionParams::default(),
            pose_error: PoseError::default(),
            pose_rate_hz: 20.0,
            odometry: OdometryModel::default(),
            odometry_rate_hz: 50.0,
        }
    }
}

impl DriveParams {
    /// Checks rates and speeds.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), Error> {
        let rate = |name, value| within(name, value, (0.1, 1000.0), "from 0.1 to 1000 per second");
        rate("pose_rate_hz", self.pose_rate_hz)?;
        rate("odometry_rate_hz", self.odometry_rate_hz)?;
        self.radars.iter().try_for_each(RadarSpec::validate)?;
        let motion = &self.motion;
        let (slow, fast) = motion.cruise_mps;
        within("cruise_mps", slow, (0.5, 40.0), "from 0.5 to 40 m/s")?;
        within("cruise_mps", fast, (0.5, 40.0), "from 0.5 to 40 m/s")?;
        within("acceleration_mps2", motion.acceleration_mps2, (0.1, 10.0), "from 0.1 to 10 m/s2")?;
        within("lateral_mps2", motion.lateral_mps2, (0.1, 10.0), "from 0.1 to 10 m/s2")?;
        within("stop_probability", motion.stop_probability, (0.0, 1.0), "from 0 to 1")?;
        within("max_duration_s", self.max_duration_s, (1.0, f64::INFINITY), "at least 1 s")
    }
}

/// Drives a route on one day and records it. The same arguments give the same bytes.
///
/// # Errors
/// When a parameter is out of range.
pub fn simulate(day: &CityDay<'_>, route: &Route, params: &DriveParams) -> Result<Drive, Error> {
    params.validate()?;
    let today = u64::from(day.day());
    let motion = Motion::along(route, &params.motion, &mut stream(params.seed, Purpose::Motion, today, 0));
    let clock = Clock {
        start_us: params.start_time_us,
        duration_us: (1e6 * motion.duration_s().min(params.max_duration_s)) as i64,
    };
    let at = |time_us: i64| motion.at((time_us - clock.start_us) as f64 * 1e-6);

    let true_odometry: Vec<_> = clock.ticks(params.odometry_rate_hz, 0.0).map(|t| (t, at(t).pose)).collect();
    let mut rng = stream(params.seed, Purpose::Odometry, today, 0);
    let odometry = params.odometry.observe(&true_odometry, &mut rng)?;

    let true_poses: Vec<_> = clock.ticks(params.pose_rate_hz, 0.0).map(|t| (t, at(t).pose)).collect();
    let mut wander = Wander::new(params.pose_error, stream(params.seed, Purpose::Reference, today, 0));
    let believed: Vec<_> = true_poses.iter().map(|(t, pose)| (*t, wander.believe(*t, pose))).collect();
    let site = day.city().site();

    Ok(Drive {
        vehicle: params.vehicle.clone(),
        mounts: params.radars.iter().map(|radar| radar.mount).collect(),
        scans: scans(day, params, &clock, at),
        odometry,
        reference: located(site, &believed, &params.pose_error)?,
        truth: located(site, &true_poses, &PoseError::NONE)?,
    })
}

/// The time a drive takes.
struct Clock {
    start_us: i64,
    duration_us: i64,
}

impl Clock {
    /// Times at a rate, the first one `phase` of a period after the start.
    fn ticks(&self, rate_hz: f64, phase: f64) -> impl Iterator<Item = i64> + use<> {
        let (start_us, end_us) = (self.start_us, self.start_us + self.duration_us);
        let tick = move |k: u32| start_us + (1e6 * (f64::from(k) + phase) / rate_hz).round() as i64;
        (0..).map(tick).take_while(move |time_us| *time_us <= end_us)
    }
}

/// Scans of all radars in order of time; they take turns within a period.
fn scans(
    day: &CityDay<'_>,
    params: &DriveParams,
    clock: &Clock,
    at: impl Fn(i64) -> MotionState,
) -> Vec<Scan> {
    let today = u64::from(day.day());
    let count = params.radars.len() as f64;
    let mut all = Vec::new();
    for (sensor, spec) in params.radars.iter().enumerate() {
        let rng = stream(params.seed, Purpose::Radar, today, sensor as u64);
        let mut scanner = Scanner::new(day, spec, sensor, rng);
        for time_us in clock.ticks(spec.rate_hz, sensor as f64 / count) {
            let body = at(time_us);
            all.push(scanner.scan(time_us, &body, &around(day, time_us, &body.pose)));
        }
    }
    all.sort_by_key(|scan| (scan.time_us, scan.sensor));
    all
}

/// Traffic near enough to matter; what drives through the vehicle itself is left out.
fn around(day: &CityDay<'_>, time_us: i64, body: &Pose2) -> Vec<Mover> {
    let near = |m: &Mover| (8.0..200.0).contains(&m.vehicle.pose.distance_m(body));
    day.movers(time_us).filter(near).collect()
}

fn located(site: &Site, poses: &[(i64, Pose2)], error: &PoseError) -> Result<Vec<GeoPose>, Error> {
    let grid = Grid::new(site.zone())?;
    let locate = |(time_us, pose): &(i64, Pose2)| {
        let (at, yaw_rad) = grid.pose_to_geodetic(&site.pose_to_map(pose))?;
        Ok(GeoPose {
            time_us: *time_us,
            at,
            yaw_rad,
            sigma_position_m: error.sigma_position_m,
            sigma_yaw_rad: error.sigma_yaw_rad,
        })
    };
    poses.iter().map(locate).collect()
}

#[cfg(test)]
mod tests;
