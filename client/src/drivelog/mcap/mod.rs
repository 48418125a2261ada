//! A drive as one MCAP file.

mod messages;
mod read;
mod records;
mod schema;
mod write;

pub(super) use read::read;
pub(super) use write::write;

/// The topics of an MCAP drive log.
///
/// The messages are protobuf; `echofix.log.v1` is defined in this crate's `proto` folder, and every
/// log embeds the definitions. Log times are the measurements' own times.
pub mod topic {
    /// `echofix.log.v1.RadarScan`: one message a scan.
    pub const SCANS: &str = "/radar/scans";
    /// `echofix.log.v1.OdometryPose`.
    pub const ODOMETRY: &str = "/odometry";
    /// `echofix.log.v1.GeodeticPose`: what the vehicle's positioning believed.
    pub const REFERENCE: &str = "/pose/reference/geodetic";
    /// `echofix.log.v1.GeodeticPose`: where the vehicle really was.
    pub const TRUTH: &str = "/pose/truth/geodetic";
    /// `foxglove.LocationFix`: the reference once more, for map panels; not read back.
    pub const REFERENCE_FIX: &str = "/pose/reference";
    /// `foxglove.LocationFix`: the truth once more, for map panels; not read back.
    pub const TRUTH_FIX: &str = "/pose/truth";
    /// The metadata record with `vehicle`, and for every radar `sensor.N` = `x_m y_m yaw_rad`: metres
    /// forward and left of the body's origin, and the boresight, radians counter-clockwise from forward.
    pub const DRIVE: &str = "echofix.drive";
}
