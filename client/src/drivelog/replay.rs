//! A drive as the stream of measurements the vehicle had.

use std::iter;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::pose::Pose2;
use echofix_core::scan::Scan;

/// One measurement of a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DriveEvent<'a> {
    /// An odometry pose and its time, microseconds since the Unix epoch.
    Odometry(i64, Pose2),
    /// What the vehicle's positioning believed.
    Reference(&'a GeoPose),
    /// Where the vehicle really was.
    Truth(&'a GeoPose),
    /// A scan.
    Scan(&'a Scan),
}

impl DriveEvent<'_> {
    /// Microseconds since the Unix epoch.
    #[must_use]
    pub fn time_us(&self) -> i64 {
        match self {
            Self::Odometry(time_us, _) => *time_us,
            Self::Reference(pose) | Self::Truth(pose) => pose.time_us,
            Self::Scan(scan) => scan.time_us,
        }
    }
}

/// Everything a drive holds in order of time; at the same time poses come before scans. Each stream
/// stays in its own order.
pub fn replay(drive: &Drive) -> impl Iterator<Item = DriveEvent<'_>> {
    let mut odometry = drive.odometry.iter().map(|(t, pose)| DriveEvent::Odometry(t, pose)).peekable();
    let mut reference = drive.reference.iter().map(DriveEvent::Reference).peekable();
    let mut truth = drive.truth.iter().map(DriveEvent::Truth).peekable();
    let mut scans = drive.scans.iter().map(DriveEvent::Scan).peekable();
    iter::from_fn(move || {
        let heads = [odometry.peek(), reference.peek(), truth.peek(), scans.peek()];
        let times = heads.map(|head| head.map(DriveEvent::time_us));
        let first = (0..times.len()).filter(|i| times[*i].is_some()).min_by_key(|i| times[*i])?;
        match first {
            0 => odometry.next(),
            1 => reference.next(),
            2 => truth.next(),
            _ => scans.next(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::any_drive;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn everything_comes_once_and_in_order(drive in any_drive()) {
            let events: Vec<_> = replay(&drive).collect();
            let all = drive.scans.len() + drive.odometry.len() + drive.reference.len() + drive.truth.len();
            prop_assert_eq!(events.len(), all);
            prop_assert!(events.is_sorted_by_key(DriveEvent::time_us));
        }
    }
}
