//! The sums, their mean, and how far it may err.

use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;

fn offset() -> impl Strategy<Value = Offset> {
    (-500..500_i32, -500..500_i32, -9000..9000_i32).prop_map(|(east_mm, north_mm, yaw_urad)| Offset {
        east_mm,
        north_mm,
        yaw_urad,
    })
}

fn id() -> TileId {
    TileId { zone: Zone::from_epsg(32614).expect("a zone"), y: 100, x: 200 }
}

fn summed(offsets: &[Offset]) -> Datum {
    let mut datum = Datum::default();
    for offset in offsets {
        datum.add(*offset, PoseSigma::default());
    }
    datum
}

proptest! {
    /// Catches: floating-point sums, and a merge that forgets a part.
    #[test]
    fn the_order_and_the_grouping_do_not_matter(mut offsets in prop::collection::vec(offset(), 0..20), cut in 0..20_usize) {
        let forward = summed(&offsets);
        offsets.reverse();
        let cut = cut.min(offsets.len());
        let mut merged = summed(&offsets[..cut]);
        merged.merge(&summed(&offsets[cut..]));
        prop_assert_eq!(forward, merged);
    }

    #[test]
    fn the_mean_is_the_mean(offsets in prop::collection::vec(offset(), 1..20)) {
        let mean = summed(&offsets).mean().expect("there are some");
        let n = offsets.len() as f64;
        let by_hand = |part: fn(&Offset) -> i32| offsets.iter().map(|o| f64::from(part(o))).sum::<f64>() / n;
        prop_assert!((mean.x_m * 1e3 - by_hand(|o| o.east_mm)).abs() < 1e-6);
        prop_assert!((mean.y_m * 1e3 - by_hand(|o| o.north_mm)).abs() < 1e-6);
        prop_assert!((mean.yaw_rad * 1e6 - by_hand(|o| o.yaw_urad)).abs() < 1e-6);
    }

    /// Catches: the nearest tile's mean instead of an interpolation, and wrong neighbours.
    #[test]
    fn the_interpolation_is_continuous_and_meets_the_centres(
        offsets in prop::collection::vec(offset(), 25), x in 1.0..3.99_f64, y in 1.0..3.99_f64,
    ) {
        let tiles: BTreeMap<(i32, i32), Datum> =
            (0..25).map(|i| ((i / 5, i % 5), summed(&offsets[i as usize..=i as usize]))).collect();
        let datum = |at: TileId| tiles.get(&(at.y - 100, at.x - 200)).copied().unwrap_or_default();
        let position = |x: f64, y: f64| MapPoint::new((200.0 + x) * TILE_M, (100.0 + y) * TILE_M);
        let at = |x, y| mean_offset(id().zone, position(x, y), datum);
        let (a, b) = (at(x, y), at(x + 1e-4, y + 1e-4));
        prop_assert!(a.distance_m(&b) < 1e-3, "{:?} {:?}", a, b);
        let centre = at(x.floor() + 0.5, y.floor() + 0.5);
        let own = tiles[&(y as i32, x as i32)].mean().expect("it has one");
        prop_assert!(centre.distance_m(&own) < 1e-6);
    }
}

#[test]
fn tiles_without_a_datum_are_left_out() {
    let mut datum = Datum::default();
    datum.add(Offset { east_mm: 100, north_mm: 0, yaw_urad: 0 }, PoseSigma::default());
    let MapPoint { x_m: x, y_m: y } = id().origin();
    let at = |x, y| {
        mean_offset(id().zone, MapPoint::new(x, y), |at| if at == id() { datum } else { Datum::default() })
    };
    assert!((at(x + 40.0, y + 40.0).x_m - 0.1).abs() < 1e-9);
    assert_eq!(at(x + 500.0, y), Pose2::IDENTITY);
    assert_eq!(Datum::default().mean(), None);
}

fn of_sigma(offsets: &[(Offset, PoseSigma)]) -> Datum {
    let mut datum = Datum::default();
    for (offset, sigma) in offsets {
        datum.add(*offset, *sigma);
    }
    datum
}

fn sigma() -> impl Strategy<Value = PoseSigma> {
    (0.0..0.5_f64, 0.0..0.01_f64, any::<bool>()).prop_map(|(position_m, yaw_rad, silent)| {
        if silent { PoseSigma::default() } else { PoseSigma::declared(position_m, yaw_rad) }
    })
}

proptest! {
    /// Catches: a weight or a square that is forgotten in a merge, and sums that depend on the order.
    #[test]
    fn declared_passes_add_up_in_any_order(
        mut passes in prop::collection::vec((offset(), sigma()), 1..20), cut in 0..20_usize,
    ) {
        let forward = of_sigma(&passes);
        passes.reverse();
        let mut merged = of_sigma(&passes[..cut.min(passes.len())]);
        merged.merge(&of_sigma(&passes[cut.min(passes.len())..]));
        prop_assert_eq!(forward, merged);
        let weight = |sigma: &PoseSigma| sigma.position_m().powi(-2);
        let east = passes.iter().map(|(o, s)| o.pose().x_m * weight(s)).sum::<f64>();
        let all = passes.iter().map(|(_, s)| weight(s)).sum::<f64>();
        prop_assert!((forward.mean().unwrap().x_m - east / all).abs() < 1e-3);
        // Never better than what was declared.
        prop_assert!(forward.variance().unwrap().position_m2 > 0.999 / all);
    }
}

#[test]
fn a_survey_errs_by_what_it_declares_and_many_by_less() {
    let sigma_m = |position_m, passes| {
        let one = (Offset::default(), PoseSigma::declared(position_m, 0.002));
        of_sigma(&vec![one; passes]).variance().unwrap().position_m2.sqrt()
    };
    assert!((sigma_m(0.3, 1) - 0.3).abs() < 1e-3 && (sigma_m(0.1, 1) - 0.1).abs() < 1e-3);
    assert!((sigma_m(0.1, 20) - 0.1 / 20_f64.sqrt()).abs() < 1e-3);
    // Nothing declared is what the map had before.
    assert!((summed(&[Offset::default(); 4]).variance().unwrap().position_m2 - 0.0016).abs() < 1e-9);
    assert_eq!(Datum::default().variance(), None);
}

/// Catches: a declaration that is believed against what vetting measures.
#[test]
fn a_scatter_beyond_what_was_declared_counts() {
    let spread = |mm: i32| {
        let at = |i: i32| Offset { east_mm: mm * (i % 3 - 1), north_mm: mm * (i % 2), yaw_urad: 0 };
        let passes: Vec<_> = (0..12).map(|i| (at(i), PoseSigma::declared(0.05, 0.002))).collect();
        of_sigma(&passes).variance().unwrap().position_m2.sqrt()
    };
    let declared = 0.05 / 12_f64.sqrt();
    assert!((spread(40) - declared).abs() < 1e-3, "{}", spread(40));
    // Standard deviations of 0.82 and 0.5 of the step.
    let realised = 0.3 * (0.5 * (0.667 + 0.25) / 12.0_f64).sqrt();
    assert!((0.8..1.2).contains(&(spread(300) / realised)), "{} {realised}", spread(300));
}
