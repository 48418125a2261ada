use super::*;
use echofix_core::vetting::matching::MatchingLimits;

fn default_policy() -> Policy {
    crate::mapping::MappingConfig::default().policy()
}

fn varied() -> Policy {
    let matching = MatchingLimits {
        extent_m: 1e-7,
        reach_m: 1e16,
        reach_yaw_rad: 0.1 + 0.2,
        min_points: 7,
        score_temperature: 1.0,
        temperature: -0.0,
        near_m: f64::MIN_POSITIVE,
        near_yaw_rad: 2.5,
        min_margin: 1e15,
        covered_within_m: 123_456.75,
    };
    let limits = VettingLimits {
        shift_m: 0.1,
        yaw_rad: 0.2,
        sigma_m: 0.3,
        sigma_yaw_rad: 0.4,
        min_coverage: 0.5,
        known_coverage: 0.6,
        min_contrast: 0.7,
        matching,
    };
    Policy {
        publish_contributors: 200,
        decay: Some(Decay { half_life_days: 12.5, expire_days: 65_535 }),
        vetting: Some(limits),
    }
}

/// The encodings and digests as they are: a change of any of them folds every map anew.
#[test]
fn the_encoding_stays_as_it_is() {
    let trusting = "echofix-policy 1\nfolding 00000001\npublish-contributors 0000000000000001\n\
                    decay 0000000000000000\nvetting 0000000000000000\n";
    let default = "echofix-policy 1
folding 00000001
publish-contributors 0000000000000003
decay 0000000000000001
decay.half-life-days 4066800000000000
decay.expire-days 000000000000016d
vetting 0000000000000001
vetting.shift-m 3fdccccccccccccd
vetting.yaw-rad 3f91df46a2529d39
vetting.sigma-m 3fbeb851eb851eb8
vetting.sigma-yaw-rad 3f6c987103b761f5
vetting.min-coverage 3fd3333333333333
vetting.known-coverage 3feccccccccccccd
vetting.min-contrast 3ff599999999999a
probing.extent-m 4046800000000000
probing.reach-m 401999999999999a
probing.reach-yaw-rad 3fb1df46a2529d39
probing.min-points 000000000000012c
probing.score-temperature 4024000000000000
probing.temperature 4000000000000000
probing.home-m 3fe0000000000000
probing.home-yaw-rad 3f91df46a2529d39
probing.min-margin 4028000000000000
probing.covered-within-m 4000000000000000
";
    let varied_text = "echofix-policy 1
folding 00000002
publish-contributors 00000000000000c8
decay 0000000000000001
decay.half-life-days 4029000000000000
decay.expire-days 000000000000ffff
vetting 0000000000000001
vetting.shift-m 3fb999999999999a
vetting.yaw-rad 3fc999999999999a
vetting.sigma-m 3fd3333333333333
vetting.sigma-yaw-rad 3fd999999999999a
vetting.min-coverage 3fe0000000000000
vetting.known-coverage 3fe3333333333333
vetting.min-contrast 3fe6666666666666
probing.extent-m 3e7ad7f29abcaf48
probing.reach-m 4341c37937e08000
probing.reach-yaw-rad 3fd3333333333334
probing.min-points 0000000000000007
probing.score-temperature 3ff0000000000000
probing.temperature 8000000000000000
probing.home-m 0010000000000000
probing.home-yaw-rad 4004000000000000
probing.min-margin 430c6bf526340000
probing.covered-within-m 40fe240c00000000
";
    assert_eq!(encoding::encode(&Policy::trusting(), 1), trusting);
    assert_eq!(encoding::encode(&default_policy(), 1), default);
    assert_eq!(encoding::encode(&varied(), 2), varied_text);
    assert_eq!(siphash(trusting.as_bytes()), 0x331d_8ef4_89f6_6c70);
    assert_eq!(siphash(default.as_bytes()), 0xecf8_b5c9_5feb_6c1f);
    assert_eq!(FOLDING, 1, "the digests below are those of the first way to fold");
    assert_eq!(Policy::trusting().digest(), 0x331d_8ef4_89f6_6c70);
    assert_eq!(default_policy().digest(), 0xecf8_b5c9_5feb_6c1f);
    assert_eq!(varied().digest(), 0x0d71_d8f4_8a86_b477);
}

/// What `{FOLDING} {policy:?}` printed, and its digest, when manifests held it.
#[test]
fn the_legacy_text_is_what_services_wrote() {
    let default = "1 Policy { publish_contributors: 3, decay: Some(Decay { half_life_days: 180.0, expire_days: 365 }), \
        vetting: Some(Limits { shift_m: 0.45, yaw_rad: 0.017453292519943295, sigma_m: 0.12, sigma_yaw_rad: \
        0.003490658503988659, min_coverage: 0.3, known_coverage: 0.9, min_contrast: 1.35, probing: Probing { extent_m: \
        45.0, reach_m: 6.4, reach_yaw_rad: 0.06981317007977318, min_points: 300, score_temperature: 10.0, temperature: \
        2.0, home_m: 0.5, home_yaw_rad: 0.017453292519943295, min_margin: 12.0, covered_within_m: 2.0 } }) }";
    let trusting = "1 Policy { publish_contributors: 1, decay: None, vetting: None }";
    let varied_text = "1 Policy { publish_contributors: 200, decay: Some(Decay { half_life_days: 12.5, expire_days: \
        65535 }), vetting: Some(Limits { shift_m: 0.1, yaw_rad: 0.2, sigma_m: 0.3, sigma_yaw_rad: 0.4, min_coverage: \
        0.5, known_coverage: 0.6, min_contrast: 0.7, probing: Probing { extent_m: 1e-7, reach_m: 1e16, reach_yaw_rad: \
        0.30000000000000004, min_points: 7, score_temperature: 1.0, temperature: -0.0, home_m: \
        2.2250738585072014e-308, home_yaw_rad: 2.5, min_margin: 1000000000000000.0, covered_within_m: 123456.75 } }) }";
    assert_eq!(legacy::text(&default_policy(), 1), default);
    assert_eq!(legacy::text(&Policy::trusting(), 1), trusting);
    assert_eq!(legacy::text(&varied(), 1), varied_text);
    assert_eq!(siphash(default.as_bytes()), 0x32a1_93c5_f2e2_3e51);
    assert_eq!(siphash(trusting.as_bytes()), 0xeb2c_e15a_4937_d92e);
    assert_eq!(siphash(varied_text.as_bytes()), 0xc618_e6ec_3542_a1fb);
    assert_eq!(default_policy().legacy_digest(), 0x32a1_93c5_f2e2_3e51);
}

/// Catches: a field that the encoding leaves out.
#[test]
fn every_number_tells_policies_apart() {
    let same = varied();
    let mut digests = std::collections::BTreeSet::from([same.digest()]);
    let mut count = 1;
    let mut changed = |change: &dyn Fn(&mut Policy, &mut Decay, &mut VettingLimits)| {
        let (mut policy, mut decay, mut limits) = (same, same.decay.unwrap(), same.vetting.unwrap());
        change(&mut policy, &mut decay, &mut limits);
        digests.insert(Policy { decay: Some(decay), vetting: Some(limits), ..policy }.digest());
        count += 1;
        assert_eq!(digests.len(), count);
    };
    changed(&|policy, _, _| policy.publish_contributors -= 1);
    changed(&|_, decay, _| decay.half_life_days += 1.0);
    changed(&|_, decay, _| decay.expire_days -= 1);
    let of_limits: [fn(&mut VettingLimits) -> &mut f64; 7] = [
        |limits| &mut limits.shift_m,
        |limits| &mut limits.yaw_rad,
        |limits| &mut limits.sigma_m,
        |limits| &mut limits.sigma_yaw_rad,
        |limits| &mut limits.min_coverage,
        |limits| &mut limits.known_coverage,
        |limits| &mut limits.min_contrast,
    ];
    let of_matching: [fn(&mut VettingLimits) -> &mut f64; 9] = [
        |limits| &mut limits.matching.extent_m,
        |limits| &mut limits.matching.reach_m,
        |limits| &mut limits.matching.reach_yaw_rad,
        |limits| &mut limits.matching.score_temperature,
        |limits| &mut limits.matching.temperature,
        |limits| &mut limits.matching.near_m,
        |limits| &mut limits.matching.near_yaw_rad,
        |limits| &mut limits.matching.min_margin,
        |limits| &mut limits.matching.covered_within_m,
    ];
    for field in of_limits.into_iter().chain(of_matching) {
        changed(&|_, _, limits| *field(limits) = 99.5);
    }
    changed(&|_, _, limits| limits.matching.min_points += 1);
    assert_ne!(
        siphash(encoding::encode(&same, 2).as_bytes()),
        siphash(encoding::encode(&same, 3).as_bytes())
    );
    assert!(Policy { decay: None, ..same }.digest() != Policy { vetting: None, ..same }.digest());
}
