//! A recorded drive: what a vehicle logs, what the simulator makes, what a drive log stores.
//!
//! [`segment`] splits it into the parts that can be mapped from.

pub mod segment;

use crate::geo::LatLon;
use crate::odometry::Trajectory;
use crate::scan::{Mount, Scan};

/// A geodetic pose at a time, with how well it is known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GeoPose {
    /// Microseconds since the Unix epoch (UTC).
    pub time_us: i64,
    /// Position of the body's origin.
    pub at: LatLon,
    /// Heading, radians counter-clockwise from true east.
    pub yaw_rad: f64,
    /// One-sigma error of the position along each axis, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the heading, radians.
    pub sigma_yaw_rad: f64,
}

/// One drive of one vehicle.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drive {
    /// Name of the vehicle, as it identifies itself to the service.
    pub vehicle: String,
    /// The radars; [`Scan::sensor`] indexes them.
    pub mounts: Vec<Mount>,
    /// Scans of all radars, oldest first.
    pub scans: Vec<Scan>,
    /// Odometry in the vehicle's own frame.
    pub odometry: Trajectory,
    /// What the vehicle's positioning (GNSS, INS) believed, oldest first; may be empty.
    pub reference: Vec<GeoPose>,
    /// Where the vehicle really was, when that is known better than `reference`; may be empty.
    pub truth: Vec<GeoPose>,
}
