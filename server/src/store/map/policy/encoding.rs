//! The bytes by which policies are distinguished.
//!
//! ASCII lines, each a tag, a blank and a value in lower-case hexadecimal: 8 digits of the way to fold, 16 of everything
//! else. Integers stand for themselves, floating-point numbers for their IEEE 754 bits (binary64). The lines in order:
//!
//! ```text
//! echofix-policy 1                 the version of this encoding
//! folding                          the way to fold
//! publish-contributors
//! decay                            1 where there is decay, else 0; its lines follow only where there is
//! decay.half-life-days, decay.expire-days
//! vetting                          1 where uploads are vetted, else 0; its lines follow only where they are
//! vetting.shift-m, vetting.yaw-rad, vetting.sigma-m, vetting.sigma-yaw-rad, vetting.min-coverage,
//! vetting.known-coverage, vetting.min-contrast,
//! probing.extent-m, probing.reach-m, probing.reach-yaw-rad, probing.min-points, probing.score-temperature,
//! probing.temperature, probing.home-m, probing.home-yaw-rad, probing.min-margin, probing.covered-within-m
//! ```
//!
//! A tag is part of the format: it stays when the field in the code is renamed. A new field gets a new tag at the end of
//! its group, and is left out where its value means what was done before there was the field; then maps keep their lineage.

use std::fmt::Write;

use echofix_core::tile::Decay;
use echofix_core::vetting::VettingLimits;
use echofix_core::vetting::matching::MatchingLimits;

use crate::store::map::policy::Policy;

/// The encoding of a policy and a way to fold.
pub(in crate::store) fn encode(policy: &Policy, folding: u32) -> String {
    // No field may be left out: without `..` a new one does not compile until it has its line.
    let Policy { publish_contributors, decay, vetting } = policy;
    let mut out = Lines(format!("echofix-policy 1\nfolding {folding:08x}\n"));
    out.integer("publish-contributors", (*publish_contributors).into());
    out.integer("decay", decay.is_some().into());
    if let Some(Decay { half_life_days, expire_days }) = decay {
        out.float("decay.half-life-days", *half_life_days);
        out.integer("decay.expire-days", (*expire_days).into());
    }
    out.integer("vetting", vetting.is_some().into());
    if let Some(limits) = vetting {
        out.vetting(limits);
    }
    out.0
}

struct Lines(String);

impl Lines {
    fn vetting(&mut self, limits: &VettingLimits) {
        let VettingLimits {
            shift_m,
            yaw_rad,
            sigma_m,
            sigma_yaw_rad,
            min_coverage,
            known_coverage,
            min_contrast,
            matching,
        } = limits;
        self.float("vetting.shift-m", *shift_m);
        self.float("vetting.yaw-rad", *yaw_rad);
        self.float("vetting.sigma-m", *sigma_m);
        self.float("vetting.sigma-yaw-rad", *sigma_yaw_rad);
        self.float("vetting.min-coverage", *min_coverage);
        self.float("vetting.known-coverage", *known_coverage);
        self.float("vetting.min-contrast", *min_contrast);
        self.matching(matching);
    }

    fn matching(&mut self, limits: &MatchingLimits) {
        let MatchingLimits {
            extent_m,
            reach_m,
            reach_yaw_rad,
            min_points,
            score_temperature,
            temperature,
            near_m,
            near_yaw_rad,
            min_margin,
            covered_within_m,
        } = limits;
        self.float("probing.extent-m", *extent_m);
        self.float("probing.reach-m", *reach_m);
        self.float("probing.reach-yaw-rad", *reach_yaw_rad);
        self.integer("probing.min-points", *min_points as u64);
        self.float("probing.score-temperature", *score_temperature);
        self.float("probing.temperature", *temperature);
        self.float("probing.home-m", *near_m);
        self.float("probing.home-yaw-rad", *near_yaw_rad);
        self.float("probing.min-margin", *min_margin);
        self.float("probing.covered-within-m", *covered_within_m);
    }

    fn float(&mut self, tag: &str, value: f64) {
        self.integer(tag, value.to_bits());
    }

    fn integer(&mut self, tag: &str, value: u64) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "{tag} {value:016x}");
    }
}
