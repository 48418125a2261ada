use proptest::prelude::*;

use super::*;
use crate::plane::{add, direction, distance, left, sub};

fn city() -> City {
    City::generate(&CityParams::default()).unwrap()
}

#[test]
fn the_same_seed_builds_the_same_town_and_another_one_another() {
    assert_eq!(city().structure(), city().structure());
    let other = City::generate(&CityParams { seed: 2, ..CityParams::default() }).unwrap();
    assert_ne!(other.structure(), city().structure());
}

#[test]
fn parked_cars_change_from_day_to_day_and_nothing_else_does() {
    let city = city();
    let (one, two) = (city.on_day(1), city.on_day(2));
    assert_eq!(one.parked(), city.on_day(1).parked());
    let fraction = |day: &CityDay| day.parked().len() as f64 / city.slots().len() as f64;
    assert!((0.55..0.75).contains(&fraction(&one)) && (0.55..0.75).contains(&fraction(&two)));
    // The same slot may be taken on both days, but hardly by a car of the same size and position.
    let unchanged = one.parked().iter().filter(|car| two.parked().contains(car)).count();
    assert_eq!(unchanged, 0);
    let taken_again = |car: &&Car| two.parked().iter().any(|c| c.pose.distance_m(&car.pose) < 2.0);
    let again = one.parked().iter().filter(taken_again).count() as f64 / one.parked().len() as f64;
    assert!((0.5..0.8).contains(&again), "{again}");
}

#[test]
fn nobody_parks_in_a_driving_lane_or_in_another_car() {
    let city = city();
    for day in 0..5 {
        let parked = city.on_day(day).parked().to_vec();
        for (k, car) in parked.iter().enumerate() {
            let street = |s: &Street| {
                let along = direction(s.a, s.b);
                let way = sub([car.pose.x_m, car.pose.y_m], s.a);
                let x = way[0] * along[0] + way[1] * along[1];
                (0.0..s.length_m())
                    .contains(&x)
                    .then_some((way[0] * left(along)[0] + way[1] * left(along)[1]).abs())
            };
            let aside_m = city.network().streets().iter().filter_map(street).fold(f64::MAX, f64::min);
            assert!(aside_m > LANE_M + 2.2, "{aside_m}");
            for other in &parked[..k] {
                let gap_m = car.pose.distance_m(&other.pose) - 0.5 * (car.length_m + other.length_m);
                assert!(gap_m > 0.0 || car.pose.distance_m(&other.pose) > 5.0, "{gap_m}");
            }
        }
    }
}

#[test]
fn a_wall_hides_what_is_behind_it() {
    let city = city();
    let day = city.on_day(1);
    let street = city.network().streets()[0];
    let (mid, along) = (add(street.a, 0.5, sub(street.b, street.a)), direction(street.a, street.b));
    let pole = |aside_m: f64| Reflector {
        at: add(mid, aside_m, left(along)),
        facing: None,
        edge_cos: 0.0,
        probability: 1.0,
        rcs_dbsm: 0.0,
        kind: ReflectorKind::Pole,
    };
    assert!(day.transmission(mid, &pole(street.kerb_m - 2.5)) > 0.99);
    assert!(day.transmission(mid, &pole(street.front_m + 25.0)) < 0.01);
}

#[test]
fn a_parked_car_hides_the_kerb_and_dims_a_pole() {
    let city = city();
    let day = city.on_day(1);
    let car = day.parked()[10];
    let (eye, behind) = (car.pose.transform([0.3, 4.0]), car.pose.transform([0.3, -1.2]));
    let thing =
        |kind| Reflector { at: behind, facing: None, edge_cos: 0.0, probability: 1.0, rcs_dbsm: 0.0, kind };
    assert!(day.transmission(eye, &thing(ReflectorKind::Kerb)) < 0.01);
    assert!((0.2..0.8).contains(&day.transmission(eye, &thing(ReflectorKind::Pole))));
}

#[test]
fn every_reflector_on_a_front_is_on_the_street_side_of_its_wall() {
    let city = city();
    let fixed = &city.structure().reflectors;
    let on_fronts = fixed.iter().filter(|r| matches!(r.kind, ReflectorKind::Wall));
    let hidden = on_fronts.clone().filter(|r| {
        let facing = r.facing.unwrap();
        let blocked = |turn: f64| {
            let (s, c) = turn.sin_cos();
            let way = [c * facing[0] - s * facing[1], s * facing[0] + c * facing[1]];
            city.walls().blocks(add(r.at, 0.5, way), r.at)
        };
        // Those that face along their wall are seen from one side only.
        blocked(0.0) && blocked(0.5) && blocked(-0.5)
    });
    let fraction = hidden.count() as f64 / on_fronts.count() as f64;
    assert!(fraction < 0.01, "{fraction}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_valid_town_can_be_built(
        seed in any::<u64>(), blocks_x in 1..5_usize, blocks_y in 1..5_usize,
        block_w_m in 70.0..200.0_f64, block_h_m in 70.0..200.0_f64,
        irregularity_m in 0.0..8.0_f64, rotation_rad in -3.2..3.2_f64,
    ) {
        let params = CityParams {
            seed, blocks_x, blocks_y, block_w_m, block_h_m, irregularity_m, rotation_rad, ..CityParams::default()
        };
        let city = City::generate(&params).unwrap();
        prop_assert!(city.streets_m() > 4.0 * 50.0);
        let reach_m = (block_w_m * blocks_x as f64).hypot(block_h_m * blocks_y as f64);
        for reflector in &city.structure().reflectors {
            prop_assert!(distance(reflector.at, [0.0, 0.0]) < reach_m);
            prop_assert!((0.0..=1.0).contains(&reflector.probability));
        }
        prop_assert!(city.on_day(0).parked().len() <= city.slots().len());
    }
}

#[test]
fn bad_parameters_are_named() {
    let refused = |params: CityParams| City::generate(&params).unwrap_err().to_string();
    let text = refused(CityParams { block_w_m: 30.0, ..CityParams::default() });
    assert_eq!(text, "`block_w_m` is 30; it must be from 70 to 500 m");
    let pole = echofix_core::geo::LatLon { lat_deg: 89.0, lon_deg: 0.0 };
    assert!(refused(CityParams { origin: pole, ..CityParams::default() }).contains("no place on the map"));
}
