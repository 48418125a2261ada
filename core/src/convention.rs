//! Data in another convention than the contract's, told in words.
//!
//! An azimuth that counts clockwise, a radial speed that is positive towards the radar or free of the own motion, a
//! yaw from north: each passes every check of ranges and lengths, and makes a map of nothing. What gives it away is
//! that things do not fit together: standing objects that seem to move, a car that seems to drive sideways. Each convention that is often
//! mistaken is tried in place of the contract's. One is suspected where most of what tells the two
//! apart stands still with it, and next to nothing without: traffic, be it dense, never is everything that is seen.
//!
//! - [`Inspection`]: gathers scans and poses, and says what is wrong with them ([`Finding`]).
//! - [`inspect`]: the same for the scans of a batch.
//! - [`radial`]: radial speeds and azimuths against the own motion. [`heading`]: yaw against the direction of travel.

pub mod heading;
pub mod radial;

use std::fmt;

use crate::drive::GeoPose;
use crate::odometry::{BodyVelocity, Trajectory};
use crate::pose::{Pose2, wrap_angle};
use crate::scan::{Mount, ScanView};
use heading::Travel;
use radial::RadarTally;

/// A convention that data may be in, other than the contract's.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Convention {
    /// Radial speeds are positive towards the radar.
    RadialSpeedTowards,
    /// The vehicle's own motion was taken out of the radial speeds.
    RadialSpeedCompensated,
    /// Radial speeds are in kilometres per hour.
    RadialSpeedKmh,
    /// Azimuths count clockwise.
    AzimuthClockwise,
    /// Azimuths are in degrees.
    AzimuthDegrees,
    /// Yaw counts clockwise from north, as a compass does.
    YawFromNorth,
    /// Yaw counts counter-clockwise from north.
    YawFromNorthCounterClockwise,
    /// Yaw counts clockwise from east.
    YawClockwise,
    /// Yaw is in degrees.
    YawDegrees,
    /// Latitude and longitude are exchanged.
    LatLonSwapped,
}

impl Convention {
    /// What to ask whoever sent such data.
    #[must_use]
    pub fn question(self) -> &'static str {
        match self {
            Self::RadialSpeedTowards => "is the radial speed positive away from the sensor?",
            Self::RadialSpeedCompensated => {
                "is the radial speed relative to the sensor, with the vehicle's own motion still in it?"
            }
            Self::RadialSpeedKmh => "is the radial speed in metres per second, not in km/h?",
            Self::AzimuthClockwise => "does the azimuth count counter-clockwise from the boresight?",
            Self::AzimuthDegrees => "is the azimuth in radians, not in degrees?",
            Self::YawFromNorth => {
                "is the yaw counted counter-clockwise from true east, not clockwise from north?"
            }
            Self::YawFromNorthCounterClockwise => "is the yaw counted from true east, not from north?",
            Self::YawClockwise => "is the yaw counted counter-clockwise?",
            Self::YawDegrees => "is the yaw in radians, not in degrees?",
            Self::LatLonSwapped => "are latitude and longitude exchanged?",
        }
    }
}

/// Whose yaw it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum YawOf {
    /// Reference poses on the globe.
    Reference,
    /// Odometry in its own frame.
    Odometry,
}

impl fmt::Display for YawOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Reference => "the reference poses'",
            Self::Odometry => "the odometry's",
        })
    }
}

/// What is wrong with data, and which conventions would explain it.
#[derive(Debug, Clone, PartialEq)]
pub enum Finding {
    /// Returns seem to move.
    Moving {
        /// Returns that do.
        moving: u64,
        /// Returns that were looked at.
        of: u64,
        /// The radar that alone shows it; `None` for all of them.
        sensor: Option<usize>,
        /// What would make most of them stand still; empty when nothing usual does.
        suspects: Vec<Convention>,
    },
    /// Azimuths are larger than a full turn.
    BeyondATurn {
        /// Azimuths that are.
        beyond: u64,
        /// Azimuths that were looked at.
        of: u64,
    },
    /// The vehicle seems to drive sideways.
    Sideways {
        /// Whose yaw is off.
        yaw: YawOf,
        /// By how much, degrees, at the median.
        off_deg: f64,
        /// What would turn it into the direction of travel; one of them, when there are several.
        suspects: Vec<Convention>,
    },
}

impl Finding {
    /// The conventions that would explain it.
    #[must_use]
    pub fn suspects(&self) -> &[Convention] {
        match self {
            Self::Moving { suspects, .. } | Self::Sideways { suspects, .. } => suspects,
            Self::BeyondATurn { .. } => &[Convention::AzimuthDegrees],
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = |part: u64, of: u64| 100.0 * part as f64 / of.max(1) as f64;
        let otherwise = match self {
            Self::Moving { moving, of, sensor, .. } => {
                write!(f, "{:.0} % of the returns", percent(*moving, *of))?;
                if let Some(sensor) = sensor {
                    write!(f, " of sensor {sensor}")?;
                }
                write!(f, " were dropped as moving:")?;
                "check signs and units of radial speeds and azimuths, the mounts and the clocks; in dense traffic it may be true"
            }
            Self::BeyondATurn { beyond, of } => {
                write!(f, "{:.0} % of the azimuths exceed a full turn:", percent(*beyond, *of))?;
                ""
            }
            Self::Sideways { yaw, off_deg, .. } => {
                write!(f, "{yaw} yaw is {off_deg:.0} degrees off the direction of travel:")?;
                "yaw is radians, counter-clockwise from true east, of the body's forward axis"
            }
        };
        if self.suspects().is_empty() {
            return write!(f, " {otherwise}");
        }
        self.suspects().iter().try_for_each(|suspect| write!(f, " {}", suspect.question()))
    }
}

/// Findings as one text, empty without any.
#[must_use]
pub fn in_words(findings: &[Finding]) -> String {
    findings.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// Looks at data as they come, in any order but for poses, and says what is wrong with them.
#[derive(Debug, Clone, Default)]
pub struct Inspection {
    radars: Vec<RadarTally>,
    reference: Travel,
    odometry: Travel,
}

impl Inspection {
    /// Takes the returns of a scan, before any gate; `velocity` is the body's at its time.
    pub fn see(&mut self, scan: &ScanView<'_>, mount: &Mount, velocity: BodyVelocity) {
        if self.radars.len() <= scan.sensor {
            self.radars.resize_with(scan.sensor + 1, RadarTally::default);
        }
        self.radars[scan.sensor].see(scan, mount, velocity);
    }

    /// Takes the next reference pose, oldest first.
    pub fn pass(&mut self, pose: &GeoPose) {
        self.reference.pass_geodetic(pose);
    }

    /// Takes the next odometry pose, oldest first.
    pub fn roll(&mut self, time_us: i64, pose: &Pose2) {
        self.odometry.pass(time_us, pose);
    }

    /// What is wrong. A yaw that is off explains movers, too, and is told alone then.
    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        let sideways = [
            self.reference.sideways(YawOf::Reference, Some(&self.odometry)),
            self.odometry.sideways(YawOf::Odometry, None),
        ];
        let found: Vec<Finding> = sideways.into_iter().flatten().collect();
        if !found.is_empty() {
            return found;
        }
        let all = RadarTally::sum(&self.radars);
        let of_all = all.beyond_a_turn().or_else(|| all.moving(None));
        if let Some(finding) = of_all.as_ref().filter(|finding| !finding.suspects().is_empty()) {
            return vec![finding.clone()];
        }
        // One radar of several may be wrong alone.
        let each = self.radars.iter().enumerate();
        let alone: Vec<Finding> = each
            .filter_map(|(sensor, tally)| tally.beyond_a_turn().or_else(|| tally.moving(Some(sensor))))
            .filter(|finding| !finding.suspects().is_empty())
            .collect();
        if alone.is_empty() { of_all.into_iter().collect() } else { alone }
    }

    /// The finding about so many returns that a gate dropped as movers, and so many that it left: where they outnumber
    /// what stands. It names the conventions that the inspection suspects.
    #[must_use]
    pub fn mostly_moving(&self, moving: u64, standing: u64) -> Option<Finding> {
        (moving > standing).then(|| {
            let mut suspects: Vec<Convention> =
                self.findings().iter().flat_map(Finding::suspects).copied().collect();
            suspects.sort_unstable();
            suspects.dedup();
            Finding::Moving { moving, of: moving.saturating_add(standing), sensor: None, suspects }
        })
    }
}

/// What is wrong with the scans of a batch and the odometry that organises them.
#[must_use]
pub fn inspect<'a, S>(scans: S, mounts: &[Mount], odometry: &Trajectory) -> Inspection
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let mut inspection = Inspection::default();
    inspect_onto(&mut inspection, scans, mounts, odometry);
    odometry.iter().for_each(|(time_us, pose)| inspection.roll(time_us, &pose));
    inspection
}

/// Adds scans to an inspection, with the velocities of a trajectory.
pub(crate) fn inspect_onto<'a, S>(inspection: &mut Inspection, scans: S, mounts: &[Mount], way: &Trajectory)
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    for scan in scans.into_iter().map(Into::into) {
        let Some(mount) = mounts.get(scan.sensor) else { continue };
        if let Some(velocity) = way.velocity_at(scan.time_us) {
            inspection.see(&scan, mount, velocity);
        }
    }
}

/// The convention in which a believed yaw would have been right, where another one was found; `None` where they agree anyway
/// or none explains it. Radians, counter-clockwise from true east.
#[must_use]
pub fn yaw_suspect(believed_rad: f64, found_rad: f64) -> Option<Convention> {
    const AGREES_RAD: f64 = 0.1;
    let off = |yaw: f64| wrap_angle(found_rad - yaw).abs();
    let tried = heading::YAWS.into_iter().map(|(convention, read)| (convention, off(read(believed_rad))));
    let (convention, least) = tried.min_by(|(_, a), (_, b)| a.total_cmp(b))?;
    (least < AGREES_RAD && off(believed_rad) > 3.0 * AGREES_RAD).then_some(convention)
}

#[cfg(test)]
mod tests;
