//! One line of belief through time: which fixes are let in, and when others overrule it.

use echofix_core::pose::Pose2;

use super::belief::Belief;
use super::config::FilterConfig;
use super::local_fix::LocalFix;
use super::measurement::FixOutcome;
use super::step::OdometryStep;

/// A fix that was not let in, and may yet be proved right by others.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rival {
    time_us: i64,
    odometry: Pose2,
    fix: LocalFix,
}

/// What is believed at one time, and who contradicts it.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Track {
    belief: Option<Belief>,
    /// Oldest first; all agree with each other.
    rivals: Vec<Rival>,
    /// What time the last fix that was let in is for.
    last_fix_us: Option<i64>,
}

impl Track {
    pub(super) fn belief(&self) -> Option<&Belief> {
        self.belief.as_ref()
    }

    /// Fixes in a row that contradict the belief and agree with each other.
    pub(super) fn rivals(&self) -> usize {
        self.rivals.len()
    }

    pub(super) fn last_fix_us(&self) -> Option<i64> {
        self.last_fix_us
    }

    /// The track after a way.
    pub(super) fn carried(&self, step: &OdometryStep, config: &FilterConfig) -> Self {
        let belief = self.belief.and_then(|belief| belief.carried(step, config));
        Self { belief, rivals: self.rivals.clone(), last_fix_us: self.last_fix_us }
    }

    /// The track with the fix of an odometry pose's time taken into account, or not.
    pub(super) fn with(&self, fix: &LocalFix, at: (i64, Pose2), config: &FilterConfig) -> (Self, FixOutcome) {
        let innovation = self.belief.and_then(|belief| Some((belief, belief.innovation(fix)?)));
        if let Some((belief, innovation)) = innovation
            && innovation.nis <= config.gate_nis
        {
            return (
                Self::believing(&belief.corrected(&innovation), fix),
                FixOutcome::Used { nis: innovation.nis },
            );
        }
        let nis = innovation.map_or(f64::INFINITY, |(_, innovation)| innovation.nis);
        let rivals = self.rivals_with(fix, at, config);
        let agreeing = rivals.len();
        let overruled = agreeing >= config.recovery.agreeing
            && (self.belief.is_none() || span_s(&rivals) >= config.recovery.span_s);
        if overruled && let Some(belief) = consensus(&rivals, config) {
            let outcome = if self.belief.is_none() { FixOutcome::Started } else { FixOutcome::Reset { nis } };
            return (Self::believing(&belief, fix), outcome);
        }
        let outcome = match self.belief {
            Some(_) => FixOutcome::Gated { nis, agreeing },
            None => FixOutcome::Waiting { agreeing },
        };
        (Self { rivals, ..*self }, outcome)
    }

    /// The same track in a plane in which the old one's origin has this pose.
    pub(super) fn moved_to(&self, old_origin: &Pose2) -> Self {
        let moved = |rival: &Rival| Rival { fix: rival.fix.moved_to(old_origin), ..*rival };
        Self {
            belief: self.belief.map(|belief| belief.moved_to(old_origin)),
            rivals: self.rivals.iter().map(moved).collect(),
            last_fix_us: self.last_fix_us,
        }
    }

    fn believing(belief: &Belief, fix: &LocalFix) -> Self {
        Self { belief: Some(*belief), rivals: Vec::new(), last_fix_us: Some(fix.end_us) }
    }

    /// The rivals that agree with a new one, and the new one.
    fn rivals_with(
        &self,
        fix: &LocalFix,
        (time_us, odometry): (i64, Pose2),
        config: &FilterConfig,
    ) -> Vec<Rival> {
        let new = Rival { time_us, odometry, fix: *fix };
        let recent = |old: &&Rival| new.since(old).time_s <= config.recovery.within_s;
        let agrees = |old: &&Rival| new.agrees_with(old, config);
        let mut rivals: Vec<Rival> = self.rivals.iter().filter(recent).filter(agrees).copied().collect();
        rivals.push(new);
        rivals
    }
}

impl Rival {
    fn since(&self, earlier: &Self) -> OdometryStep {
        OdometryStep::between((earlier.time_us, earlier.odometry), (self.time_us, self.odometry))
    }

    /// Whether this fix would be let in by a filter started from an earlier one.
    fn agrees_with(&self, earlier: &Self, config: &FilterConfig) -> bool {
        let carried = Belief::from_fix(&earlier.fix, config).carried(&self.since(earlier), config);
        let innovation = carried.and_then(|belief| belief.innovation(&self.fix));
        innovation.is_some_and(|innovation| innovation.nis <= config.gate_nis)
    }
}

fn span_s(rivals: &[Rival]) -> f64 {
    match rivals {
        [first, .., last] => last.since(first).time_s,
        _ => 0.0,
    }
}

/// The belief of fixes that agree, at the time of the last.
fn consensus(rivals: &[Rival], config: &FilterConfig) -> Option<Belief> {
    let mut belief = Belief::from_fix(&rivals.first()?.fix, config);
    for pair in rivals.windows(2) {
        belief = belief.carried(&pair[1].since(&pair[0]), config)?;
        belief = belief.corrected(&belief.innovation(&pair[1].fix)?);
    }
    Some(belief)
}
