//! The sliding window: odometry, and the gated scans it covers.

use std::collections::VecDeque;

use echofix_core::convention::Inspection;
use echofix_core::gate::{Dropped, gate_scan};
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::slices::slices;
use echofix_core::scan::{Mount, Scan};

use super::{Error, VehicleConfig};

/// The last seconds of a drive.
#[derive(Debug, Clone)]
pub(super) struct ScanWindow {
    config: VehicleConfig,
    /// As they are used now.
    mounts: Vec<Mount>,
    /// As they were stated. Data in another convention are looked for by these: calibrated ones are bent towards them.
    built: Vec<Mount>,
    odometry: Trajectory,
    /// Metres travelled from the very first pose to the newest.
    travelled_m: f64,
    /// Scans that odometry does not cover yet, oldest first.
    waiting: Vec<Scan>,
    /// Gated scans, oldest first.
    gated: Vec<Scan>,
    dropped: Dropped,
    /// What was dropped of the window's scans, with their times.
    dropped_lately: VecDeque<(i64, Dropped)>,
    inspection: Inspection,
}

impl ScanWindow {
    pub(super) fn new(config: &VehicleConfig, mounts: Vec<Mount>) -> Self {
        Self {
            config: *config,
            built: mounts.clone(),
            mounts,
            odometry: Trajectory::default(),
            travelled_m: 0.0,
            waiting: Vec::new(),
            gated: Vec::new(),
            dropped: Dropped::default(),
            dropped_lately: VecDeque::new(),
            inspection: Inspection::default(),
        }
    }

    pub(super) fn push_scan(&mut self, scan: &Scan) -> Result<(), Error> {
        scan.validate()?;
        let (sensor, time_us) = (scan.sensor, scan.time_us);
        if sensor >= self.mounts.len() {
            return Err(Error::UnknownSensor { sensor, mounts: self.mounts.len() });
        }
        let span_us = micros(self.config.window_s);
        let newest_us = self.odometry.last().map(|(newest_us, _)| newest_us);
        if newest_us.is_none_or(|newest_us| time_us > newest_us.saturating_add(span_us)) {
            self.refuse(scan);
            return Err(Error::AheadOfOdometry { time_us });
        }
        if time_us < self.oldest_us() {
            self.refuse(scan);
            return Err(Error::TooLate { time_us, oldest_us: self.oldest_us() });
        }
        for slice in slices(&scan.into()) {
            if slice.time_us < self.oldest_us() {
                self.dropped.without_pose += slice.len() as u64;
            } else {
                insert(&mut self.waiting, slice);
            }
        }
        self.settle();
        Ok(())
    }

    /// Counts a scan that is taken from no known pose, so that the next request tells of it.
    fn refuse(&mut self, scan: &Scan) {
        let dropped = Dropped { without_pose: scan.len() as u64, ..Dropped::default() };
        self.dropped.add(&dropped);
        if let Some((newest_us, _)) = self.odometry.last() {
            self.dropped_lately.push_back((newest_us, dropped));
        }
    }

    pub(super) fn push_odometry(&mut self, time_us: i64, pose: Pose2) -> Result<(), Error> {
        let last = self.odometry.last();
        self.odometry.push(time_us, pose)?;
        self.inspection.roll(time_us, &pose);
        if let Some((last_us, last)) = last {
            self.travelled_m += last.distance_m(&pose);
            if time_us - last_us > micros(self.config.max_odometry_gap_s) {
                self.drop_waiting_within(last_us, time_us);
            }
        }
        self.settle();
        let oldest_us = self.oldest_us();
        self.gated.retain(|scan| scan.time_us >= oldest_us);
        self.dropped_lately.retain(|(time_us, _)| *time_us >= oldest_us);
        self.odometry.trim_before(oldest_us);
        Ok(())
    }

    /// Gated scans, oldest first; none is empty, all are covered by odometry.
    pub(super) fn scans(&self) -> &[Scan] {
        &self.gated
    }

    /// Radars that turned out to sit elsewhere.
    pub(super) fn set_mounts(&mut self, mounts: impl Iterator<Item = Mount>) {
        for (mount, corrected) in self.mounts.iter_mut().zip(mounts) {
            *mount = corrected;
        }
    }

    pub(super) fn mounts(&self) -> &[Mount] {
        &self.mounts
    }

    pub(super) fn odometry(&self) -> &Trajectory {
        &self.odometry
    }

    /// Detections dropped since the beginning, by the reason.
    pub(super) fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Detections dropped of the scans in the window, by the reason.
    pub(super) fn dropped_lately(&self) -> Dropped {
        let mut all = Dropped::default();
        self.dropped_lately.iter().for_each(|(_, dropped)| all.add(dropped));
        all
    }

    /// What the scans and the odometry say of themselves.
    pub(super) fn inspection(&self) -> &Inspection {
        &self.inspection
    }

    /// The odometry pose at a time, and the metres travelled until then.
    pub(super) fn at(&self, time_us: i64) -> Option<(Pose2, f64)> {
        let pose = self.odometry.at(time_us)?;
        let since = self.odometry.iter().filter(|(t, _)| *t > time_us);
        let mut back_m = 0.0;
        let mut from = pose;
        for (_, to) in since {
            back_m += from.distance_m(&to);
            from = to;
        }
        Some((pose, self.travelled_m - back_m))
    }

    /// Speed over ground at the newest odometry pose, metres per second.
    pub(super) fn speed_mps(&self) -> Option<f64> {
        let (newest_us, _) = self.odometry.last()?;
        Some(self.odometry.velocity_at(newest_us)?.speed_mps())
    }

    /// Where the window begins, microseconds since the Unix epoch.
    pub(super) fn oldest_us(&self) -> i64 {
        let newest_us = self.odometry.last().map_or(i64::MIN, |(t, _)| t);
        newest_us.saturating_sub(micros(self.config.window_s))
    }

    /// Gates the scans that odometry has come to cover.
    fn settle(&mut self) {
        // A single pose has no velocity.
        let Some((newest_us, _)) = self.odometry.last().filter(|_| self.odometry.len() > 1) else { return };
        let covered = self.waiting.partition_point(|scan| scan.time_us <= newest_us);
        for mut scan in self.waiting.drain(..covered) {
            let velocity = self.odometry.velocity_at(scan.time_us);
            let mount = &self.mounts[scan.sensor];
            if let Some(velocity) = velocity {
                self.inspection.see(&(&scan).into(), &self.built[scan.sensor], velocity);
            }
            let dropped = gate_scan(&mut scan, mount, velocity, &self.config.gate);
            self.dropped.add(&dropped);
            if dropped.total() > 0 {
                self.dropped_lately.push_back((scan.time_us, dropped));
            }
            if !scan.is_empty() {
                // Geometry is sent, and radial speeds correct the odometry; do not hold the rest.
                scan.rcs_dbsm = Vec::new();
                insert(&mut self.gated, scan);
            }
        }
    }

    fn drop_waiting_within(&mut self, after_us: i64, before_us: i64) {
        let lost = |scan: &Scan| scan.time_us > after_us && scan.time_us < before_us;
        let detections: usize = self.waiting.iter().filter(|s| lost(s)).map(Scan::len).sum();
        self.dropped.without_pose += detections as u64;
        self.waiting.retain(|scan| !lost(scan));
    }
}

/// Inserts by time, after those of the same time.
fn insert(scans: &mut Vec<Scan>, scan: Scan) {
    let at = scans.partition_point(|s| s.time_us <= scan.time_us);
    scans.insert(at, scan);
}

/// Seconds as microseconds.
pub(super) fn micros(seconds: f64) -> i64 {
    (seconds * 1e6).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::T0;

    fn window() -> ScanWindow {
        ScanWindow::new(&VehicleConfig::default(), vec![Mount::IDENTITY; 2])
    }

    fn scan(sensor: usize, time_us: i64) -> Scan {
        Scan { sensor, time_us, range_m: vec![10.0], azimuth_rad: vec![0.2], ..Scan::default() }
    }

    /// Straight east at a speed, a pose every 0.1 s.
    fn drive(window: &mut ScanWindow, from: i64, to: i64, speed_mps: f64) {
        for i in from..to {
            let x_m = speed_mps * i as f64 * 0.1;
            window.push_odometry(T0 + i * 100_000, Pose2::new(x_m, 0.0, 0.0)).unwrap();
        }
    }

    #[test]
    fn scans_of_several_radars_are_ordered_and_wait_for_odometry() {
        let mut w = window();
        drive(&mut w, 0, 2, 10.0);
        for (sensor, offset_us) in [(0, 150_000), (1, 120_000), (0, 50_000), (1, 250_000)] {
            w.push_scan(&scan(sensor, T0 + offset_us)).unwrap();
        }
        let times = |w: &ScanWindow| w.scans().iter().map(|s| s.time_us - T0).collect::<Vec<_>>();
        assert_eq!(times(&w), [50_000], "the others are ahead of odometry");
        drive(&mut w, 2, 4, 10.0);
        assert_eq!(times(&w), [50_000, 120_000, 150_000, 250_000]);
    }

    #[test]
    fn the_window_slides() {
        let mut w = window();
        for i in 0..100 {
            drive(&mut w, i, i + 1, 10.0);
            w.push_scan(&scan(0, T0 + i * 100_000)).unwrap();
        }
        assert_eq!(w.scans().len(), 51);
        assert_eq!(w.odometry().len(), 51);
        assert!((w.at(T0 + 9_900_000).unwrap().1 - 99.0).abs() < 1e-9);
        assert!((w.at(T0 + 9_850_000).unwrap().1 - 98.5).abs() < 1e-9);
        let error = w.push_scan(&scan(0, T0)).unwrap_err();
        assert!(matches!(error, Error::TooLate { .. }), "{error}");
    }

    #[test]
    fn slow_scans_and_scans_in_a_gap_of_odometry_are_dropped() {
        let mut w = window();
        drive(&mut w, 0, 5, 0.5);
        w.push_scan(&scan(0, T0 + 200_000)).unwrap();
        assert_eq!((w.scans().len(), w.dropped().too_slow), (0, 1));
        w.push_scan(&scan(0, T0 + 900_000)).unwrap();
        drive(&mut w, 20, 21, 0.5);
        assert_eq!(w.dropped().without_pose, 1);
    }

    #[test]
    fn what_cannot_be_placed_is_refused() {
        let mut w = window();
        assert!(matches!(w.push_scan(&scan(0, T0)), Err(Error::AheadOfOdometry { .. })));
        drive(&mut w, 0, 2, 10.0);
        assert!(matches!(w.push_scan(&scan(2, T0)), Err(Error::UnknownSensor { sensor: 2, mounts: 2 })));
        assert!(matches!(w.push_scan(&scan(0, T0 + 60_000_000)), Err(Error::AheadOfOdometry { .. })));
        let torn = Scan { azimuth_rad: vec![], ..scan(0, T0) };
        assert!(matches!(w.push_scan(&torn), Err(Error::Scan(_))));
        assert!(matches!(w.push_odometry(T0, Pose2::IDENTITY), Err(Error::Odometry(_))));
    }
}
