//! Yaw against the direction of travel.
//!
//! A car drives where it points, or backwards. Over steps that are long against the poses' errors its course is compared with its
//! yaw; what is off by 30 to 150 degrees on most steps is not a car, but another convention. A yaw from north is right in
//! value towards the north-east and the south-west: such a street tells nothing.

use std::f64::consts::FRAC_PI_2;

use super::{Convention, Finding, YawOf};
use crate::drive::GeoPose;
use crate::geo::{LatLon, MetresPerDegree};
use crate::pose::{Pose2, wrap_angle};

/// A convention, and what turns a yaw in it into the contract's, radians.
type YawReading = (Convention, fn(f64) -> f64);

/// How a yaw is read.
pub(super) const YAWS: [YawReading; 4] = [
    (Convention::YawFromNorth, |yaw| FRAC_PI_2 - yaw),
    (Convention::YawFromNorthCounterClockwise, |yaw| yaw + FRAC_PI_2),
    (Convention::YawClockwise, |yaw| -yaw),
    (Convention::YawDegrees, f64::to_radians),
];

/// The shortest step, metres.
const STEP_M: f64 = 3.0;
/// A step is so many one-sigma errors of the position long.
const STEP_SIGMAS: f64 = 10.0;
/// Slower steps say nothing: a standing receiver wanders, metres per second.
const SLOWEST_MPS: f64 = 1.0;
/// Steps that a finding rests on, at least.
const MIN_STEPS: u64 = 10;
/// A yaw that is off by less than this, or by half a turn less this, is a car's, radians.
const SIDEWAYS_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
/// A convention explains a step to this, radians.
const EXPLAINED_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Share of the steps that a convention must explain.
const EXPLAINED_SHARE: f64 = 0.8;
/// Lengths of two ways that agree to this are the same, relatively.
const SAME_LENGTH: f64 = 0.05;

/// A pose as it came: a plane's metres, or degrees that are spread out when a step is made.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stop {
    time_us: i64,
    at: Place,
    yaw_rad: f64,
    sigma_m: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    Plane([f64; 2]),
    Globe(LatLon),
}

/// Steps of a way so far, and which conventions explain them.
#[derive(Debug, Clone, Default)]
pub struct Travel {
    last: Option<Stop>,
    /// Metres of all steps, and the same with latitude and longitude exchanged.
    lengths_m: [f64; 2],
    /// By how much yaw was off, degrees from 0 to 180, in bins of one.
    off_deg: Vec<u64>,
    steps: u64,
    sideways: u64,
    /// Steps explained by each of [`YAWS`], and by exchanged coordinates.
    explained: [u64; 5],
    /// Largest angle, radians, regardless of sign.
    largest_rad: f64,
}

impl Travel {
    /// Takes the next pose of a plane.
    pub fn pass(&mut self, time_us: i64, pose: &Pose2) {
        let Pose2 { x_m, y_m, yaw_rad } = *pose;
        self.stop(Stop { time_us, at: Place::Plane([x_m, y_m]), yaw_rad, sigma_m: 0.0 });
    }

    /// Takes the next pose on the globe.
    pub fn pass_geodetic(&mut self, pose: &GeoPose) {
        let GeoPose { time_us, at, yaw_rad, sigma_position_m: sigma_m, .. } = *pose;
        self.stop(Stop { time_us, at: Place::Globe(at), yaw_rad, sigma_m });
    }

    fn stop(&mut self, stop: Stop) {
        self.largest_rad = self.largest_rad.max(stop.yaw_rad.abs());
        let Some(last) = self.last else {
            self.last = Some(stop);
            return;
        };
        let way = step(last.at, stop.at);
        let length_m = way[0].hypot(way[1]);
        let seconds = (stop.time_us - last.time_us) as f64 * 1e-6;
        if !length_m.is_finite() || seconds * SLOWEST_MPS > length_m.max(STEP_M) {
            self.last = Some(stop);
        } else if length_m >= STEP_M.max(STEP_SIGMAS * last.sigma_m.max(stop.sigma_m)) {
            self.count(&last, &stop, way);
            self.last = Some(stop);
        }
    }

    fn count(&mut self, from: &Stop, to: &Stop, way: [f64; 2]) {
        let course = |[east, north]: [f64; 2]| north.atan2(east);
        // The chord of a bend points along the heading half-way.
        let off = |course: f64, read: fn(f64) -> f64| {
            let (a, b) = (read(from.yaw_rad), read(to.yaw_rad));
            wrap_angle(course - a - 0.5 * wrap_angle(b - a)).abs()
        };
        let own = off(course(way), |yaw| yaw);
        self.steps += 1;
        self.sideways += u64::from((SIDEWAYS_RAD..std::f64::consts::PI - SIDEWAYS_RAD).contains(&own));
        self.off_deg.resize(181, 0);
        self.off_deg[(own.to_degrees() as usize).min(180)] += 1;
        for ((_, read), explained) in YAWS.into_iter().zip(&mut self.explained) {
            *explained += u64::from(off(course(way), read) < EXPLAINED_RAD);
        }
        self.lengths_m[0] += way[0].hypot(way[1]);
        if let (Place::Globe(a), Place::Globe(b)) = (from.at, to.at) {
            let swapped = step(Place::Globe(exchanged(a)), Place::Globe(exchanged(b)));
            self.explained[4] += u64::from(off(course(swapped), |yaw| yaw) < EXPLAINED_RAD);
            self.lengths_m[1] += swapped[0].hypot(swapped[1]);
        }
    }

    /// The finding that the vehicle seems to drive sideways. `other`, where it went the same way, tells by its length
    /// whether coordinates are exchanged.
    #[must_use]
    pub fn sideways(&self, yaw: YawOf, other: Option<&Self>) -> Option<Finding> {
        if self.steps < MIN_STEPS || 2 * self.sideways <= self.steps {
            return None;
        }
        let enough = |explained: u64| explained as f64 >= EXPLAINED_SHARE * self.steps as f64;
        let conventions =
            YAWS.into_iter().map(|(convention, _)| convention).chain([Convention::LatLonSwapped]);
        let explaining = conventions.zip(self.explained).filter(|(_, explained)| enough(*explained));
        // Degrees are told from radians by their size.
        let possible = explaining.map(|(convention, _)| convention).filter(|convention| {
            (*convention == Convention::YawDegrees) == (self.largest_rad > std::f64::consts::TAU)
        });
        let mut suspects: Vec<Convention> = possible.collect();
        if let Some(swapped) = other.and_then(|other| self.is_exchanged(other)) {
            suspects.retain(|convention| (*convention == Convention::LatLonSwapped) == swapped);
        }
        Some(Finding::Sideways { yaw, off_deg: self.median_off_deg(), suspects })
    }

    /// Does the way have the length of another one only with latitude and longitude exchanged? `None` where the lengths do
    /// not tell.
    fn is_exchanged(&self, other: &Self) -> Option<bool> {
        let [own, swapped] =
            self.lengths_m.map(|length| (length / other.lengths_m[0] - 1.0).abs() < SAME_LENGTH);
        (own != swapped).then_some(swapped)
    }

    fn median_off_deg(&self) -> f64 {
        let mut left = self.steps / 2;
        let bin = self.off_deg.iter().position(|count| {
            let here = left < *count;
            left = left.saturating_sub(*count);
            here
        });
        bin.unwrap_or(0) as f64
    }
}

/// East and north, or x and y, from one place to another, metres.
fn step(from: Place, to: Place) -> [f64; 2] {
    match (from, to) {
        (Place::Plane([x0, y0]), Place::Plane([x1, y1])) => [x1 - x0, y1 - y0],
        (Place::Globe(a), Place::Globe(b)) => {
            let MetresPerDegree { north, east } = MetresPerDegree::WGS84;
            let east_deg = (b.lon_deg - a.lon_deg + 540.0).rem_euclid(360.0) - 180.0;
            [east_deg * east * a.lat_deg.to_radians().cos(), (b.lat_deg - a.lat_deg) * north]
        }
        _ => [f64::NAN; 2],
    }
}

fn exchanged(at: LatLon) -> LatLon {
    LatLon { lat_deg: at.lon_deg, lon_deg: at.lat_deg }
}
