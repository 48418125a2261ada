//! The science of Echofix: pure functions and values. No I/O, no async, no clock, no globals.
//!
//! The paper implemented here is L. Narula, P. A. Iannucci, T. E. Humphreys,
//! "Automotive-Radar-Based 50-cm Urban Positioning" (2020); comments cite its equation and
//! algorithm labels.
//!
//! # Example
//!
//! A vehicle with a wrong prior finds its pose in a street that is known as points:
//!
//! ```
//! use echofix_core::align::Prior;
//! use echofix_core::align_once;
//! use echofix_core::odometry::Trajectory;
//! use echofix_core::once::{OnceOptions, VehicleScans};
//! use echofix_core::point::MapPoint;
//! use echofix_core::pose::Pose2;
//! use echofix_core::scan::{Mount, Scan};
//!
//! // The map: two fronts with bays, map metres.
//! let front = |side: f64| (0..900).map(move |i| {
//!     let along = 0.1 * f64::from(i);
//!     MapPoint::new(along, side * (9.0 + 1.5 * (0.7 * along + side).sin() + (1.9 * along).cos()))
//! });
//! let map: Vec<MapPoint> = front(1.0).chain(front(-1.0)).collect();
//!
//! // Five seconds at 8 m/s: the true poses, odometry in a frame of its own, and ten scans a second.
//! let truth = |i: i64| Pose2::new(20.0 + 0.8 * i as f64, 0.5, 0.0);
//! let odometry = Trajectory::new((0..=50).map(|i| (i * 100_000, Pose2::new(0.8 * i as f64, 0.0, 0.0))))?;
//! let scan = |i: i64| {
//!     let body = truth(i).inverse();
//!     let seen: Vec<_> = map.iter().step_by(3).map(|p| body.transform((*p).into())).collect();
//!     Scan {
//!         time_us: i * 100_000,
//!         range_m: seen.iter().map(|[x, y]| x.hypot(*y) as f32).collect(),
//!         azimuth_rad: seen.iter().map(|[x, y]| y.atan2(*x) as f32).collect(),
//!         ..Scan::default()
//!     }
//! };
//! let scans: Vec<Scan> = (0..=50).map(scan).collect();
//!
//! // A prior that is off by 1.4 m and 1.7 degrees.
//! let pose = Pose2::new(truth(50).x_m + 1.2, truth(50).y_m - 0.8, 0.03);
//! let prior = Prior { pose, sigma_position_m: 1.0, sigma_yaw_rad: 0.03, scale: 1.0 };
//! let seen = VehicleScans { scans: &scans, mounts: &[Mount::IDENTITY], odometry: &odometry };
//! let answer = align_once(&map, &seen, &prior, &OnceOptions::default())?;
//!
//! assert!(answer.pose.distance_m(&truth(50)) < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Modules
//!
//! In reading order:
//!
//! - [`once`]: one alignment from plain points, as above.
//! - [`pose`]: planar poses and how they compose.
//! - [`point`]: points on the map, in the body's frame, in a radar's.
//! - [`geo`]: WGS-84 to UTM and back, meridian convergence, scale factor, zones, tile ids.
//! - [`scan`]: one radar's detections at one time, and where the radar sits.
//! - [`odometry`]: the vehicle's relative trajectory, interpolated at scan times.
//! - [`datum`]: by how much vetting moved the passes over a tile: the map's own offset.
//! - [`drive`]: one recorded drive, and its segments that can be mapped from.
//! - [`doppler`]: the vehicle's own velocity and corrected odometry from radial speeds.
//! - [`gate`]: which detections pass, and why the others are dropped.
//! - [`convention`]: data in another convention than the contract's, told in words.
//! - [`calibration`]: mounts and clocks of the radars, from the drive itself.
//! - [`batch`]: scans and odometry become one set of points in the frame of the newest pose.
//! - [`mod@own_error`]: what errors of the mounts and clocks do to the answer.
//! - [`evidence`]: what a map cell knows; the evidence delta of an upload, and how it is built from scans
//!   and poses; the inverse sensor model.
//! - [`tile`]: 512 x 512 cells of 10 cm, sparse, with their codec; who voted; what is served.
//! - [`time`]: microseconds and days.
//! - [`varint`]: the alphabet of all codecs.
//! - [`window`]: the square of the map that an alignment needs.
//! - [`agreement`]: nearest-neighbour questions: how well do points agree with the map?
//! - [`near`]: the same where only near or far is asked, in a sixth of the bytes; [`buckets`]: that exactly.
//! - [`align`]: `fast_global_align`; the pipeline from map and batch to an answer; its engines.
//! - [`vetting`]: does an upload agree with the map, and how far beside it does it lie?
//!
//! Frames: the map is UTM metres (`f64`), x east, y north; the body is x forward, y left; yaw is
//! radians, counter-clockwise from east (of the grid inside this crate, see [`geo`]).

pub mod agreement;
pub mod align;
pub mod batch;
pub mod buckets;
pub mod calibration;
mod columns;
pub mod convention;
pub mod datum;
pub mod demand;
pub mod doppler;
pub mod drive;
pub mod evidence;
pub mod gate;
pub mod geo;
pub mod near;
pub mod odometry;
pub mod once;
pub mod own_error;
pub mod point;
pub mod pose;
mod range_coder;
pub mod scan;
mod sealed;
pub mod tile;
pub mod time;
pub mod varint;
pub mod vetting;
pub mod window;

pub use once::align_once;
