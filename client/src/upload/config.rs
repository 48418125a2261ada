//! What is recorded and how it is cut.

use echofix_core::scan::Gate;

use crate::wire::Columns;

/// What is recorded and how it is cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Config {
    /// Which detections are kept.
    pub gate: Gate,
    /// Which columns are sent. Movers are dropped here, so the geometry is enough.
    pub columns: Columns,
    /// Poses less well known than this are not mapped from, metres (one sigma an axis).
    pub max_sigma_position_m: f64,
    /// Poses whose heading is less well known than this are not mapped from, radians.
    pub max_sigma_yaw_rad: f64,
    /// Scans between poses farther apart than this are dropped, seconds.
    pub max_pose_gap_s: f64,
    /// An upload is cut after this time, seconds.
    pub cut_after_s: f64,
    /// An upload is cut after this way, metres.
    pub cut_after_m: f64,
    /// Scans may come this much later than the poses that cover them, seconds.
    pub lateness_s: f64,
    /// Nothing is recorded within this distance of where a trip began and where it ended, metres, so
    /// that uploads do not tell either place. A stop of two minutes ends a trip. 0 records all.
    pub trim_ends_m: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            gate: Gate::default(),
            columns: Columns::Geometry,
            max_sigma_position_m: 0.3,
            max_sigma_yaw_rad: 0.5_f64.to_radians(),
            max_pose_gap_s: 0.5,
            cut_after_s: 10.0,
            cut_after_m: 100.0,
            lateness_s: 0.5,
            trim_ends_m: 0.0,
        }
    }
}
