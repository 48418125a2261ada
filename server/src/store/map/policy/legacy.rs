//! The text by which policies were distinguished before there were tags: what `derive(Debug)` printed then. It is frozen, names and
//! all, and only read: a manifest of the third format that holds its digest names the policy in force.

use echofix_core::tile::Decay;
use echofix_core::vetting::VettingLimits;
use echofix_core::vetting::matching::MatchingLimits;

use crate::store::map::policy::Policy;

/// The text of a policy and a way to fold. Floating-point numbers are written as `{:?}` writes them, the shortest decimal
/// that reads back as the same number.
pub(in crate::store) fn text(policy: &Policy, folding: u32) -> String {
    // A field that is added later is not in this text: where it does not mean what was done before there was the
    // field, the text must be one that no manifest holds.
    let Policy { publish_contributors, decay, vetting } = policy;
    let decay = option(decay.as_ref().map(decay_text));
    let vetting = option(vetting.as_ref().map(limits_text));
    format!(
        "{folding} Policy {{ publish_contributors: {publish_contributors}, decay: {decay}, vetting: {vetting} }}"
    )
}

fn option(text: Option<String>) -> String {
    text.map_or_else(|| "None".to_owned(), |text| format!("Some({text})"))
}

fn decay_text(decay: &Decay) -> String {
    let Decay { half_life_days, expire_days } = decay;
    format!("Decay {{ half_life_days: {half_life_days:?}, expire_days: {expire_days} }}")
}

fn limits_text(limits: &VettingLimits) -> String {
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
    let probing = probing_text(matching);
    format!(
        "Limits {{ shift_m: {shift_m:?}, yaw_rad: {yaw_rad:?}, sigma_m: {sigma_m:?}, \
         sigma_yaw_rad: {sigma_yaw_rad:?}, min_coverage: {min_coverage:?}, known_coverage: {known_coverage:?}, \
         min_contrast: {min_contrast:?}, probing: {probing} }}"
    )
}

fn probing_text(limits: &MatchingLimits) -> String {
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
    format!(
        "Probing {{ extent_m: {extent_m:?}, reach_m: {reach_m:?}, reach_yaw_rad: {reach_yaw_rad:?}, \
         min_points: {min_points}, score_temperature: {score_temperature:?}, temperature: {temperature:?}, \
         home_m: {near_m:?}, home_yaw_rad: {near_yaw_rad:?}, min_margin: {min_margin:?}, \
         covered_within_m: {covered_within_m:?} }}"
    )
}
