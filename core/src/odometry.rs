//! The vehicle's relative trajectory, and how good it is.

pub mod jumps;
mod quality;

pub use quality::OdometryQuality;

use crate::pose::{Pose2, wrap_angle};

/// Body poses at increasing times, in any one frame that does not move over the batch.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trajectory {
    time_us: Vec<i64>,
    pose: Vec<Pose2>,
}

/// Why poses do not form a trajectory.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// Times must increase strictly.
    #[error("odometry time {time_us} us does not come after {last_us} us; send poses in order of time")]
    NotIncreasing {
        /// The offending time.
        time_us: i64,
        /// The newest time before it.
        last_us: i64,
    },
    /// A pose holds NaN or infinity.
    #[error("the odometry pose at {time_us} us is not finite")]
    NotFinite {
        /// The time of the offending pose.
        time_us: i64,
    },
}

impl Error {
    /// The kind of error as one word.
    #[must_use]
    pub fn reason(&self) -> &'static str {
        match self {
            Self::NotIncreasing { .. } => "out_of_order",
            Self::NotFinite { .. } => "not_finite",
        }
    }
}

impl Trajectory {
    /// Builds a trajectory from (microseconds since the Unix epoch, pose) pairs.
    ///
    /// # Errors
    /// When times do not increase strictly or a pose is not finite.
    pub fn new(poses: impl IntoIterator<Item = (i64, Pose2)>) -> Result<Self, Error> {
        let poses = poses.into_iter();
        let least = poses.size_hint().0;
        let mut trajectory = Self { time_us: Vec::with_capacity(least), pose: Vec::with_capacity(least) };
        for (time_us, pose) in poses {
            trajectory.push(time_us, pose)?;
        }
        Ok(trajectory)
    }

    /// Appends the newest pose.
    ///
    /// # Errors
    /// When the time is not newer than the last one or the pose is not finite.
    pub fn push(&mut self, time_us: i64, pose: Pose2) -> Result<(), Error> {
        if let Some(&last_us) = self.time_us.last()
            && time_us <= last_us
        {
            return Err(Error::NotIncreasing { time_us, last_us });
        }
        if !pose.is_finite() {
            return Err(Error::NotFinite { time_us });
        }
        self.time_us.push(time_us);
        self.pose.push(pose);
        Ok(())
    }

    /// Forgets poses older than `time_us`, keeping the last one up to it for interpolation, and two in any case: one
    /// alone has no velocity.
    pub fn trim_before(&mut self, time_us: i64) {
        let from = self.time_us.partition_point(|t| *t <= time_us).saturating_sub(1);
        let from = from.min(self.len().saturating_sub(2));
        self.time_us.drain(..from);
        self.pose.drain(..from);
    }

    /// Forgets poses newer than `time_us`, keeping the first one from it on for interpolation, and two in any case.
    pub fn trim_after(&mut self, time_us: i64) {
        let until = (self.time_us.partition_point(|t| *t < time_us) + 1).max(2);
        self.time_us.truncate(until);
        self.pose.truncate(until);
    }

    /// The pose at a time within the trajectory; `None` outside it.
    #[must_use]
    pub fn at(&self, time_us: i64) -> Option<Pose2> {
        let after = self.time_us.partition_point(|t| *t < time_us);
        let t1 = *self.time_us.get(after)?;
        if t1 == time_us {
            return Some(self.pose[after]);
        }
        let before = after.checked_sub(1)?;
        let t0 = self.time_us[before];
        let fraction = (time_us - t0) as f64 / (t1 - t0) as f64;
        Some(self.pose[before].interpolate(&self.pose[after], fraction))
    }

    /// Speed and yaw rate of the segment around a time: (forward m/s, left m/s, rad/s) in the body
    /// frame; `None` outside the trajectory or with fewer than two poses.
    #[must_use]
    pub fn velocity_at(&self, time_us: i64) -> Option<BodyVelocity> {
        let (first, last) = (*self.time_us.first()?, *self.time_us.last()?);
        if self.len() < 2 || time_us < first || time_us > last {
            return None;
        }
        let after = self.time_us.partition_point(|t| *t <= time_us).clamp(1, self.len() - 1);
        let dt_s = (self.time_us[after] - self.time_us[after - 1]) as f64 * 1e-6;
        Some(BodyVelocity::of_step(&self.pose[after - 1].between(&self.pose[after]), dt_s))
    }

    /// [`Trajectory::velocity_at`]; `None`, too, where the poses around the time are farther apart than `gap_us`: between them
    /// the body may have moved anyhow.
    #[must_use]
    pub fn velocity_within(&self, time_us: i64, gap_us: i64) -> Option<BodyVelocity> {
        let after = self.time_us.partition_point(|t| *t <= time_us).clamp(1, self.len().max(2) - 1);
        let gap = self.time_us.get(after)?.saturating_sub(*self.time_us.get(after - 1)?);
        self.velocity_at(time_us).filter(|_| gap <= gap_us)
    }

    /// Mean speed and yaw rate from one time to a later one, in the body frame half-way; `None` outside
    /// the trajectory.
    #[must_use]
    pub fn velocity_between(&self, from_us: i64, to_us: i64) -> Option<BodyVelocity> {
        let step = self.at(from_us)?.between(&self.at(to_us)?);
        (from_us < to_us).then(|| BodyVelocity::of_step(&step, (to_us - from_us) as f64 * 1e-6))
    }

    /// (time in microseconds, pose) pairs, oldest first.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (i64, Pose2)> + '_ {
        self.time_us.iter().copied().zip(self.pose.iter().copied())
    }

    /// Oldest (time in microseconds, pose).
    #[must_use]
    pub fn first(&self) -> Option<(i64, Pose2)> {
        Some((*self.time_us.first()?, *self.pose.first()?))
    }

    /// Newest (time in microseconds, pose).
    #[must_use]
    pub fn last(&self) -> Option<(i64, Pose2)> {
        Some((*self.time_us.last()?, *self.pose.last()?))
    }

    /// Number of poses.
    #[must_use]
    pub fn len(&self) -> usize {
        self.time_us.len()
    }

    /// True without any pose.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.time_us.is_empty()
    }

    /// Distance travelled from the first pose to the last, metres.
    #[must_use]
    pub fn travelled_m(&self) -> f64 {
        self.pose.windows(2).map(|w| w[0].distance_m(&w[1])).sum()
    }

    /// Distance travelled between two times, metres; what lies outside the trajectory adds nothing.
    #[must_use]
    pub fn travelled_between_m(&self, from_us: i64, to_us: i64) -> f64 {
        let inside =
            self.time_us.partition_point(|t| *t < from_us)..self.time_us.partition_point(|t| *t <= to_us);
        let poses = self.pose.get(inside).unwrap_or_default().iter().copied();
        let mut way = self.at(from_us).into_iter().chain(poses).chain(self.at(to_us));
        let Some(mut here) = way.next() else { return 0.0 };
        way.map(|next| std::mem::replace(&mut here, next).distance_m(&next)).sum()
    }
}

/// Velocity of the body's origin in the body frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BodyVelocity {
    /// Metres per second along body x.
    pub forward_mps: f64,
    /// Metres per second along body y.
    pub left_mps: f64,
    /// Radians per second, counter-clockwise.
    pub yaw_rate_radps: f64,
}

impl BodyVelocity {
    /// The velocity of a relative pose that took some seconds.
    fn of_step(step: &Pose2, dt_s: f64) -> Self {
        // The chord leaves the body frame of the step's start at half the turn.
        let (s, c) = (0.5 * step.yaw_rad).sin_cos();
        Self {
            forward_mps: (c * step.x_m + s * step.y_m) / dt_s,
            left_mps: (c * step.y_m - s * step.x_m) / dt_s,
            yaw_rate_radps: wrap_angle(step.yaw_rad) / dt_s,
        }
    }

    /// Speed over ground, metres per second.
    #[must_use]
    pub fn speed_mps(&self) -> f64 {
        self.forward_mps.hypot(self.left_mps)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn circle() -> Trajectory {
        // 10 m/s on a circle of 50 m, one pose every 50 ms.
        let pose = |i: i64| {
            let a = 10.0 * i as f64 * 0.05 / 50.0;
            Pose2::new(50.0 * a.sin(), 50.0 * (1.0 - a.cos()), a)
        };
        Trajectory::new((0..100).map(|i| (i * 50_000, pose(i)))).unwrap()
    }

    #[test]
    fn velocity_on_a_circle_is_along_the_body() {
        let v = circle().velocity_at(2_500_000).unwrap();
        assert!((v.forward_mps - 10.0).abs() < 1e-3, "{v:?}");
        assert!(v.left_mps.abs() < 1e-3 && (v.yaw_rate_radps - 0.2).abs() < 1e-6, "{v:?}");
    }

    /// Catches: a velocity that is taken across a hole in the odometry.
    #[test]
    fn across_a_hole_there_is_no_velocity() {
        let poses = [0, 100_000, 5_000_000, 5_100_000].map(|t| (t, Pose2::new(t as f64 * 1e-5, 0.0, 0.0)));
        let odometry = Trajectory::new(poses).unwrap();
        let known = [0, 50_000, 3_000_000, 5_050_000, 5_100_000, 5_100_001]
            .map(|time_us| odometry.velocity_within(time_us, 1_000_000).is_some());
        assert_eq!(known, [true, true, false, true, true, false]);
        assert_eq!(Trajectory::default().velocity_within(0, 1), None);
    }

    #[test]
    fn poses_are_interpolated_inside_and_refused_outside() {
        let t = circle();
        let (a, b) = (t.at(50_000).unwrap(), t.at(100_000).unwrap());
        let mid = t.at(75_000).unwrap();
        assert!((mid.x_m - 0.5 * (a.x_m + b.x_m)).abs() < 1e-12);
        assert_eq!(t.at(-1), None);
        assert_eq!(t.at(99 * 50_000 + 1), None);
        assert_eq!(t.at(0), t.first().map(|p| p.1));
    }

    #[test]
    fn trimming_keeps_what_interpolation_needs() {
        let mut t = circle();
        t.trim_before(1_020_000);
        assert_eq!(t.first().map(|p| p.0), Some(1_000_000));
        assert!(t.at(1_020_000).is_some());
    }

    /// Catches one scan on odometry's newest pose, or on its first, that has no velocity and counts as standing.
    #[test]
    fn trimming_to_a_moment_leaves_a_velocity() {
        for time_us in [0, 50_000, 99 * 50_000] {
            let mut t = circle();
            t.trim_before(time_us);
            t.trim_after(time_us);
            assert!((t.velocity_at(time_us).unwrap().forward_mps - 10.0).abs() < 1e-3, "{time_us}");
        }
    }

    #[test]
    fn disorder_and_nan_are_refused() {
        let mut t = circle();
        let last_us = t.last().unwrap().0;
        assert_eq!(t.push(last_us, Pose2::IDENTITY), Err(Error::NotIncreasing { time_us: last_us, last_us }));
        let nan = Pose2::new(f64::NAN, 0.0, 0.0);
        assert_eq!(t.push(last_us + 1, nan), Err(Error::NotFinite { time_us: last_us + 1 }));
    }
}
