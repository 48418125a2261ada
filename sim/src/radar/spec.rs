//! What a radar can do.

use std::f64::consts::{FRAC_PI_2, PI};

use echofix_core::scan::Mount;

use crate::error::{Error, within};
use crate::plane::{Point, dot};

/// One radar: where it sits and what it can do.
#[derive(Debug, Clone, PartialEq)]
pub struct RadarSpec {
    /// Pose on the body, whose origin is the middle of the rear axle.
    pub mount: Mount,
    /// Areas seen at once; a target in any of them can be detected.
    pub fields: Vec<FieldOfView>,
    /// Scans per second.
    pub rate_hz: f64,
    /// Detections per scan at most; the strongest remain.
    pub max_detections: usize,
    /// Factor on every reflector's chance of a detection.
    pub sensitivity: f64,
    /// Mean count of detections of one reflector in a scan that sees it, at least 1: a radar that resolves more
    /// returns more of the same thing, each with errors of its own.
    pub returns: f64,
    /// Errors of a detection.
    pub noise: Noise,
    /// False detections.
    pub clutter: Clutter,
}

/// A sector in front of a radar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldOfView {
    /// Radians to either side of the boresight, at most a right angle.
    pub half_angle_rad: f64,
    /// Metres.
    pub max_range_m: f64,
}

/// One-sigma errors of a detection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Metres.
    pub range_m: f64,
    /// Radians.
    pub azimuth_rad: f64,
    /// Metres per second.
    pub radial_speed_mps: f64,
    /// Decibel, from scan to scan.
    pub rcs_db: f64,
}

/// Mean count of false detections per scan, spread evenly over the area seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clutter {
    /// While driving.
    pub moving: f64,
    /// At rest; in between up to about 2 m/s.
    pub at_rest: f64,
}

/// Targets nearer than this are not seen, metres.
pub(super) const MIN_RANGE_M: f64 = 0.5;

impl RadarSpec {
    /// A long-range and a medium-range area at once, like Delphi's ESR, at the front's centre.
    #[must_use]
    pub fn esr() -> Self {
        let field =
            |half_deg: f64, max_range_m| FieldOfView { half_angle_rad: half_deg.to_radians(), max_range_m };
        Self {
            mount: Mount::new(3.7, 0.0, 0.0),
            fields: vec![field(10.0, 175.0), field(45.0, 60.0)],
            rate_hz: 20.0,
            max_detections: 64,
            sensitivity: 2.6,
            returns: 1.0,
            noise: Noise {
                range_m: 0.15,
                azimuth_rad: 0.5_f64.to_radians(),
                radial_speed_mps: 0.1,
                rcs_db: 2.0,
            },
            clutter: Clutter { moving: 8.0, at_rest: 25.0 },
        }
    }

    /// A short-range wide radar like Delphi's SRR2, on the left (`side` = 1) or right (-1) front
    /// corner, facing 30 degrees outward.
    #[must_use]
    pub fn srr2(side: f64) -> Self {
        Self {
            mount: Mount::new(3.5, 0.75 * side, side * 30_f64.to_radians()),
            fields: vec![FieldOfView { half_angle_rad: 75_f64.to_radians(), max_range_m: 80.0 }],
            sensitivity: 2.0,
            noise: Noise {
                range_m: 0.12,
                azimuth_rad: 0.9_f64.to_radians(),
                radial_speed_mps: 0.1,
                rcs_db: 2.0,
            },
            ..Self::esr()
        }
    }

    /// The paper's three radars: ESR, SRR2 left, SRR2 right.
    #[must_use]
    pub fn paper_set() -> Vec<Self> {
        vec![Self::esr(), Self::srr2(1.0), Self::srr2(-1.0)]
    }

    /// Checks that the radar sees something and errs by numbers.
    ///
    /// # Errors
    /// The first field that is out of range.
    pub fn validate(&self) -> Result<(), Error> {
        within("fields", self.fields.len() as f64, (1.0, 100.0), "at least one field of view")?;
        for field in &self.fields {
            within("half_angle_rad", field.half_angle_rad, (0.01, FRAC_PI_2), "from 0.01 to a right angle")?;
            within("max_range_m", field.max_range_m, (1.0, 1000.0), "from 1 to 1000 m")?;
        }
        within("rate_hz", self.rate_hz, (0.1, 1000.0), "from 0.1 to 1000 per second")?;
        within("sensitivity", self.sensitivity, (0.0, 1000.0), "from 0 to 1000")?;
        within("returns", self.returns, (1.0, 100.0), "from 1 to 100")?;
        let Noise { range_m, azimuth_rad, radial_speed_mps, rcs_db } = self.noise;
        for (name, sigma) in [
            ("noise.range_m", range_m),
            ("noise.azimuth_rad", azimuth_rad),
            ("noise.radial_speed_mps", radial_speed_mps),
            ("noise.rcs_db", rcs_db),
        ] {
            within(name, sigma, (0.0, 1000.0), "from 0 to 1000")?;
        }
        within("clutter.moving", self.clutter.moving, (0.0, 1000.0), "from 0 to 1000 per scan")?;
        within("clutter.at_rest", self.clutter.at_rest, (0.0, 1000.0), "from 0 to 1000 per scan")
    }

    /// Largest range seen in any direction, metres.
    #[must_use]
    pub fn max_range_m(&self) -> f64 {
        self.fields.iter().map(|f| f.max_range_m).fold(0.0, f64::max)
    }

    /// Largest angle from the boresight at any range, radians.
    #[must_use]
    pub fn max_angle_rad(&self) -> f64 {
        self.fields.iter().map(|f| f.half_angle_rad).fold(0.0, f64::max)
    }

    /// True for a range and azimuth the radar sees.
    #[must_use]
    pub fn sees(&self, range_m: f64, azimuth_rad: f64) -> bool {
        let within = |f: &FieldOfView| range_m <= f.max_range_m && azimuth_rad.abs() <= f.half_angle_rad;
        range_m >= MIN_RANGE_M && self.fields.iter().any(within)
    }

    /// True when a circle, relative to the radar, may touch what it sees along its boresight.
    pub(super) fn may_see(&self, boresight: Point, centre: Point, radius_m: f64) -> bool {
        let range_m = centre[0].hypot(centre[1]);
        self.fields.iter().any(|f| {
            let near = range_m <= radius_m;
            range_m - radius_m <= f.max_range_m
                && (near || {
                    let half_rad = f.half_angle_rad + (radius_m / range_m).asin();
                    half_rad >= PI || dot(boresight, centre) >= range_m * half_rad.cos()
                })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_circle_with_a_visible_point_is_passed_over(
            range_m in 1.0..175.0_f64, azimuth_rad in -1.5..1.5_f64, yaw_rad in -3.0..3.0_f64,
            dx in -4.0..4.0_f64, dy in -4.0..4.0_f64,
        ) {
            let (s, c) = yaw_rad.sin_cos();
            let (sa, ca) = (yaw_rad + azimuth_rad).sin_cos();
            for spec in RadarSpec::paper_set() {
                if spec.sees(range_m, azimuth_rad) {
                    let centre = [range_m * ca + dx, range_m * sa + dy];
                    prop_assert!(spec.may_see([c, s], centre, 5.7));
                }
            }
        }
    }
}
