//! The radars of a family.

use std::f64::consts::PI;

use echofix_core::scan::Mount;

use crate::downtown;
use crate::radar::{Clutter, FieldOfView, Noise, RadarSpec};

/// Which radars a vehicle has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rig {
    /// The paper's: one at the front, two at the front corners, as [`crate::downtown`] wears them.
    Paper,
    /// One at the front, of sharp azimuth.
    SharpFront,
    /// Four at the corners.
    Corners,
    /// One on the roof that turns four times a second and measures no radial speeds.
    Spinning,
    /// One at the front with elevation, some 1000 detections a scan; its heights are left out.
    Imaging,
}

impl Rig {
    /// The radars as they are by default.
    pub(super) fn radars(self) -> Vec<RadarSpec> {
        match self {
            Self::Paper => downtown::drive().radars,
            Self::SharpFront => vec![sharp()],
            Self::Corners => corners(),
            Self::Spinning => halves(),
            Self::Imaging => vec![imaging()],
        }
    }

    /// Does it measure radial speeds?
    #[must_use]
    pub fn has_doppler(self) -> bool {
        self != Self::Spinning
    }
}

fn field(half_deg: f64, max_range_m: f64) -> FieldOfView {
    FieldOfView { half_angle_rad: half_deg.to_radians(), max_range_m }
}

fn sharp() -> RadarSpec {
    RadarSpec {
        mount: Mount::new(3.6, 0.0, 0.0),
        fields: vec![field(60.0, 100.0)],
        rate_hz: 15.0,
        max_detections: 128,
        sensitivity: 1.5,
        returns: 1.0,
        noise: Noise {
            range_m: 0.1,
            azimuth_rad: 0.25_f64.to_radians(),
            radial_speed_mps: 0.06,
            rcs_db: 2.0,
        },
        clutter: Clutter { moving: 10.0, at_rest: 20.0 },
    }
}

fn corners() -> Vec<RadarSpec> {
    let corner = |x_m: f64, y_m: f64, yaw_deg: f64| RadarSpec {
        mount: Mount::new(x_m, y_m, yaw_deg.to_radians()),
        sensitivity: 1.0,
        clutter: Clutter { moving: 20.0, at_rest: 30.0 },
        ..RadarSpec::srr2(1.0)
    };
    vec![
        corner(3.5, 0.8, 45.0),
        corner(3.5, -0.8, -45.0),
        corner(-0.8, 0.8, 135.0),
        corner(-0.8, -0.8, -135.0),
    ]
}

/// The front half of a turn and the rear half, one after the other.
fn halves() -> Vec<RadarSpec> {
    let half = |yaw_rad: f64| RadarSpec {
        mount: Mount::new(1.2, 0.0, yaw_rad),
        fields: vec![field(90.0, 100.0)],
        rate_hz: 4.0,
        max_detections: 400,
        sensitivity: 3.0,
        returns: 1.5,
        noise: Noise { range_m: 0.12, azimuth_rad: 0.9_f64.to_radians(), radial_speed_mps: 0.1, rcs_db: 2.0 },
        clutter: Clutter { moving: 40.0, at_rest: 40.0 },
    };
    vec![half(0.0), half(PI)]
}

fn imaging() -> RadarSpec {
    RadarSpec {
        mount: Mount::new(3.6, 0.0, 0.0),
        fields: vec![field(60.0, 120.0)],
        rate_hz: 12.0,
        max_detections: 1200,
        sensitivity: 4.0,
        returns: 10.0,
        noise: Noise {
            range_m: 0.15,
            azimuth_rad: 0.5_f64.to_radians(),
            radial_speed_mps: 0.15,
            rcs_db: 2.0,
        },
        clutter: Clutter { moving: 150.0, at_rest: 200.0 },
    }
}
