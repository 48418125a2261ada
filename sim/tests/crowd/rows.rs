//! Rows of parked cars of one pitch: an upload that is a pitch off fits nearly as well.

use echofix_core::vetting::{Reason, Vetted};
use echofix_sim::motion::MotionParams;
use echofix_sim::{
    City, CityParams, DriveParams, OdometryModel, PoseError, Route, Scene, downtown, simulate,
};

use crate::map::{CrowdMap, Upload, uploads};

fn sent(city: &City, day: u32, number: u64, motion: MotionParams, north_m: f64) -> Vec<Upload> {
    let seed = city.params().seed * 1000 + number;
    let pose_error = PoseError { sigma_position_m: 0.1, ..PoseError::default() };
    let params = DriveParams {
        seed,
        odometry: OdometryModel::Perfect,
        pose_error,
        motion,
        max_duration_s: 240.0,
        ..downtown::drive()
    };
    let mut drive = simulate(&city.on_day(day), &Route::survey(city, seed), &params).expect("it is valid");
    for pose in &mut drive.reference {
        pose.at.lat_deg += north_m / 111_132.0;
    }
    uploads(&drive, number)
}

/// What vetting makes of uploads: how many, how many shifted, how many that disagree.
fn counted(vetted: impl IntoIterator<Item = Vetted>) -> [usize; 3] {
    let mut counts = [0; 3];
    for vetted in vetted {
        counts[0] += 1;
        match vetted {
            Vetted::Quarantined { reason: Reason::Shifted, .. } => counts[1] += 1,
            Vetted::Quarantined { .. } => counts[2] += 1,
            Vetted::Agrees(_) | Vetted::New(_) => {}
        }
    }
    counts
}

/// What becomes of honest uploads after a survey that crawled and stopped beside the rows.
fn after_a_slow_survey(seed: u64, contributors: u64) -> [usize; 3] {
    let city = Scene::ParkedCars.city(seed).expect("it is valid");
    let slow = MotionParams { cruise_mps: (1.2, 4.0), ..MotionParams::default() };
    let mut map = CrowdMap::default();
    for upload in sent(&city, 0, 0, slow, 0.0) {
        map.offer(&upload);
    }
    let others = (1..=contributors)
        .flat_map(|number| sent(&city, 2 * number as u32, number, MotionParams::default(), 0.0));
    counted(others.map(|upload| map.offer(&upload)))
}

/// Catches: a hill a pitch away that is believed because the survey dwelt beside it. 9 of 10 honest uploads were kept
/// out here.
#[test]
fn honest_uploads_of_rows_of_parked_cars_are_not_kept_out() {
    let [all, shifted, disagree] = after_a_slow_survey(2, 1);
    assert!(all >= 5 && (shifted, disagree) == (0, 0), "{all} {shifted} {disagree}");
}

/// Prints the same of more rows.
#[test]
#[ignore = "minutes; a look and no check"]
fn rows_of_other_pitches() {
    for seed in 1..9 {
        println!("rows {seed}: uploads, shifted, disagree {:?}", after_a_slow_survey(seed, 3));
    }
}

/// Catches: a rule that lets through what is really off in a street that does not repeat itself.
#[test]
#[ignore = "a minute"]
fn a_town_s_uploads_that_are_off_are_kept_out() {
    let params = CityParams { blocks_x: 2, blocks_y: 2, ..downtown::city(303) };
    let city = City::generate(&params).expect("the town is valid");
    let mut map = CrowdMap::default();
    for upload in sent(&city, 0, 0, MotionParams::default(), 0.0) {
        map.offer(&upload);
    }
    for north_m in [0.0, 0.8, 1.2, 4.5, 30.0] {
        let uploads = sent(&city, 2, 1, MotionParams::default(), north_m);
        let [all, shifted, disagree] = counted(uploads.iter().map(|upload| map.vetted(upload)));
        println!("{north_m} m: of {all} {shifted} shifted, {disagree} disagree");
        let kept_out = shifted + disagree;
        assert!(if north_m < 0.5 {
            kept_out == 0
        } else if north_m > 1.0 {
            10 * kept_out > 7 * all
        } else {
            true
        });
    }
}
