use std::collections::BTreeSet;

use super::*;
use crate::radar::RadarSpec;

#[test]
fn families_have_names_of_their_own() {
    let words: BTreeSet<_> = Family::ALL.iter().map(|family| family.word()).collect();
    assert_eq!(words.len(), Family::ALL.len());
    assert!(Family::ALL.iter().all(|family| Family::of_word(family.word()) == Some(*family)));
    assert_eq!(Family::of_word("nowhere"), None);
}

/// Catches: a range that no world can be drawn from, and worlds that do not follow from their seed.
#[test]
fn every_family_draws_worlds_and_the_same_ones_again() {
    for family in Family::ALL {
        for seed in [3, 4] {
            let world = family.world(seed).unwrap();
            assert!(world.radars().iter().all(|radar| radar.validate().is_ok()), "{family:?}");
            assert!(world.city.streets_m() > 300.0, "{family:?}");
            let again = family.world(seed).unwrap();
            assert_eq!(again.city.structure(), world.city.structure(), "{family:?}");
            assert_eq!(again.radars(), world.radars(), "{family:?}");
        }
    }
}

/// Catches: sideways motion that radial speeds do not know of.
#[test]
fn the_vehicle_never_slips_sideways() {
    let world = Family::SharpPosts.world(5).unwrap();
    let drive = world.asking().unwrap();
    let truth: Vec<_> = drive.odometry.iter().collect();
    // Odometry errs by a random walk of 5 mm on a root metre; a step is 0.16 m.
    let aside: f64 = truth.windows(2).map(|w| w[0].1.between(&w[1].1).y_m).sum();
    assert!(aside.abs() < 0.5, "{aside}");
    let turned: f64 = truth.windows(2).map(|w| w[0].1.between(&w[1].1).yaw_rad.abs()).sum();
    assert!(turned > 0.05, "it sways: {turned}");
}

#[test]
fn an_imaging_radar_returns_about_a_thousand_detections() {
    let world = Family::Imaging.world(3).unwrap();
    let drive = world.asking().unwrap();
    let seen: usize = drive.scans.iter().map(echofix_core::scan::Scan::len).sum();
    let mean = seen as f64 / drive.scans.len() as f64;
    assert!((500.0..1200.0).contains(&mean), "{mean}");
}

fn total(radars: &[RadarSpec], of: fn(&RadarSpec) -> f64) -> f64 {
    radars.iter().map(of).sum()
}

#[test]
fn what_is_declared_need_not_be_true() {
    let mut least = f64::INFINITY;
    for seed in 0..4 {
        let world = Family::Dishonest.world(seed).unwrap();
        let contribution = world.contribution(0).unwrap();
        least = least.min(contribution.drives[0].reference[0].sigma_position_m);
    }
    assert!(least < 0.2, "{least}");
    let (plain, dense) = (Family::Town.world(1).unwrap(), Family::Dense.world(1).unwrap());
    assert!(total(dense.radars(), |r| r.returns) > 1.9 * total(plain.radars(), |r| r.returns));
}
