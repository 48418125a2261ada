//! The last seconds, so that a fix can be taken into account at the time it is for.

use std::collections::VecDeque;

use echofix_core::odometry;
use echofix_core::pose::Pose2;

use super::config::FilterConfig;
use super::local_fix::LocalFix;
use super::measurement::{Error, FixOutcome};
use super::step::OdometryStep;
use super::track::Track;

/// A time at which odometry is known.
#[derive(Debug, Clone, PartialEq)]
struct Node {
    time_us: i64,
    odometry: Pose2,
    /// What is believed before the fix of this time.
    track: Track,
    fix: Option<LocalFix>,
}

impl Node {
    fn at(&self) -> (i64, Pose2) {
        (self.time_us, self.odometry)
    }

    /// What is believed after the fix of this time, and what became of the fix.
    fn settled(&self, config: &FilterConfig) -> (Track, Option<FixOutcome>) {
        match &self.fix {
            None => (self.track.clone(), None),
            Some(fix) => {
                let (track, outcome) = self.track.with(fix, self.at(), config);
                (track, Some(outcome))
            }
        }
    }

    fn followed_by(&self, time_us: i64, odometry: Pose2, config: &FilterConfig) -> Self {
        let step = OdometryStep::between(self.at(), (time_us, odometry));
        Self { time_us, odometry, track: self.settled(config).0.carried(&step, config), fix: None }
    }
}

/// Odometry, fixes and beliefs, oldest first.
#[derive(Debug, Clone, Default)]
pub(super) struct History {
    nodes: VecDeque<Node>,
    /// The first odometry pose ever, or since the last jump.
    began_us: i64,
}

/// The time a fix measures, and odometry's way from there to the time it was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Middle {
    pub(super) time_us: i64,
    pub(super) to_end: Pose2,
}

impl History {
    /// Takes the newest odometry pose.
    ///
    /// # Errors
    /// When it is not one. After a jump the history begins anew.
    pub(super) fn push(&mut self, time_us: i64, odometry: Pose2, config: &FilterConfig) -> Result<(), Error> {
        if !odometry.is_finite() {
            return Err(odometry::Error::NotFinite { time_us }.into());
        }
        let Some(last) = self.nodes.back() else {
            self.restart(time_us, odometry);
            return Ok(());
        };
        let last_us = last.time_us;
        if time_us <= last_us {
            return Err(odometry::Error::NotIncreasing { time_us, last_us }.into());
        }
        let distance_m = last.odometry.distance_m(&odometry);
        let most_m = config.max_speed_mps * time_us.saturating_sub(last_us) as f64 * 1e-6;
        // The metre is for poses that are rounded and microseconds apart.
        if distance_m.is_nan() || distance_m > most_m + 1.0 {
            self.restart(time_us, odometry);
            return Err(Error::Jumped { time_us, distance_m });
        }
        self.thin_out(config);
        if let Some(last) = self.nodes.back() {
            let node = last.followed_by(time_us, odometry, config);
            self.nodes.push_back(node);
        }
        self.forget(time_us, config);
        Ok(())
    }

    /// The middle of the batch of a fix.
    ///
    /// # Errors
    /// The outcome of a fix that the history does not cover.
    pub(super) fn middle(&self, end_us: i64, config: &FilterConfig) -> Result<Middle, FixOutcome> {
        let batch_s = config.fixes.batch_s.min(end_us.saturating_sub(self.began_us) as f64 * 1e-6);
        let time_us = end_us.saturating_sub((config.fixes.middle * batch_s.max(0.0) * 1e6) as i64);
        let end = self.odometry_at(end_us)?;
        Ok(Middle { time_us, to_end: self.odometry_at(time_us)?.between(&end) })
    }

    /// Takes a fix into account at the time it measures, and judges those after it again.
    pub(super) fn insert(&mut self, time_us: i64, fix: LocalFix, config: &FilterConfig) -> FixOutcome {
        let odometry = match self.odometry_at(time_us) {
            Ok(odometry) => odometry,
            Err(outcome) => return outcome,
        };
        let index = self.nodes.partition_point(|node| node.time_us < time_us);
        if self.nodes[index].time_us > time_us {
            let node = self.nodes[index - 1].followed_by(time_us, odometry, config);
            self.nodes.insert(index, node);
        }
        let node = &mut self.nodes[index];
        if node.fix.is_some() {
            return FixOutcome::Duplicate;
        }
        node.fix = Some(fix);
        let outcome = node.settled(config).1.unwrap_or(FixOutcome::Duplicate);
        self.replay_after(index, config);
        outcome
    }

    /// Odometry at a time the history covers; else the outcome of a fix for that time.
    fn odometry_at(&self, time_us: i64) -> Result<Pose2, FixOutcome> {
        let after = self.nodes.partition_point(|node| node.time_us < time_us);
        let Some(next) = self.nodes.get(after) else { return Err(FixOutcome::AheadOfOdometry) };
        if next.time_us == time_us {
            return Ok(next.odometry);
        }
        let Some(before) = after.checked_sub(1).map(|i| &self.nodes[i]) else {
            return Err(FixOutcome::TooOld { oldest_us: next.time_us });
        };
        let fraction = (time_us - before.time_us) as f64 / (next.time_us - before.time_us) as f64;
        Ok(before.odometry.interpolate(&next.odometry, fraction))
    }

    /// The newest time, and what is believed then.
    pub(super) fn newest(&self, config: &FilterConfig) -> Option<(i64, Track)> {
        let node = self.nodes.back()?;
        Some((node.time_us, node.settled(config).0))
    }

    /// The same history in a plane in which the old one's origin has this pose.
    pub(super) fn move_to(&mut self, old_origin: &Pose2) {
        for node in &mut self.nodes {
            node.track = node.track.moved_to(old_origin);
            node.fix = node.fix.map(|fix| fix.moved_to(old_origin));
        }
    }

    /// Forgets all fixes and what they led to.
    pub(super) fn forget_fixes(&mut self) {
        for node in &mut self.nodes {
            (node.track, node.fix) = (Track::default(), None);
        }
    }

    fn restart(&mut self, time_us: i64, odometry: Pose2) {
        self.began_us = time_us;
        self.nodes = VecDeque::from([Node { time_us, odometry, track: Track::default(), fix: None }]);
    }

    fn replay_after(&mut self, index: usize, config: &FilterConfig) {
        for i in index + 1..self.nodes.len() {
            let (time_us, odometry) = self.nodes[i].at();
            self.nodes[i].track = self.nodes[i - 1].followed_by(time_us, odometry, config).track;
        }
    }

    /// Drops the newest pose if it is closer to the one before than odometry needs to be stored.
    fn thin_out(&mut self, config: &FilterConfig) {
        let Some(before) = self.nodes.len().checked_sub(2).map(|i| &self.nodes[i]) else { return };
        let dense = |last: &&Node| {
            last.fix.is_none() && OdometryStep::between(before.at(), last.at()).time_s < config.spacing_s
        };
        if self.nodes.back().as_ref().is_some_and(dense) {
            self.nodes.pop_back();
        }
    }

    fn forget(&mut self, now_us: i64, config: &FilterConfig) {
        let oldest_us = now_us.saturating_sub((config.history_s * 1e6) as i64);
        while self.nodes.get(1).is_some_and(|node| node.time_us <= oldest_us) {
            self.nodes.pop_front();
        }
    }
}
