//! Maps of contributors whose poses are known more or less well: do answers know the map's own error?

use echofix_core::align::verdict::{Integrity, Verdict};
use echofix_core::align::{Aligner, EngineKind, Prior, Search, Task};
use echofix_core::batch::Batch;
use echofix_core::drive::Drive;
use echofix_core::gate::Gate;
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;
use echofix_core::point::MapPoint;
use echofix_core::pose::wrap_angle;
use echofix_core::vetting::Vetted;
use echofix_core::window::MapSquare;
use echofix_sim::{City, CityParams, DriveParams, OdometryModel, PoseError, Route, downtown, simulate};

use crate::map::{CrowdMap, uploads};

/// One fix beside the truth: errors and sigmas along, across, of the heading (metres, radians).
struct Fix {
    usable: bool,
    error: [f64; 3],
    sigma: [f64; 3],
    beyond: bool,
}

fn city(seed: u64) -> City {
    let params = CityParams { blocks_x: 2, blocks_y: 2, ..downtown::city(seed) };
    City::generate(&params).expect("the town is valid")
}

fn driven(city: &City, day: u32, number: u64, pose_error: PoseError) -> Drive {
    let seed = city.params().seed * 1000 + number;
    let params = DriveParams { seed, odometry: OdometryModel::Perfect, pose_error, ..downtown::drive() };
    simulate(&city.on_day(day), &Route::survey(city, seed), &params).expect("the drive is valid")
}

/// Fixes of another drive on the map of some contributors, a second apart; `error` is a contributor's, and by how much its
/// declaration differs from it.
fn fixes(seed: u64, contributors: u64, error: impl Fn(u64) -> (PoseError, f64)) -> Vec<Fix> {
    let city = city(seed);
    let (mut map, mut kept, mut all) = (CrowdMap::default(), 0, 0);
    for number in 0..contributors {
        let (error, declared) = error(number);
        let mut drive = driven(&city, 0, number, error);
        for pose in &mut drive.reference {
            pose.sigma_position_m *= declared;
            pose.sigma_yaw_rad *= declared;
        }
        for upload in uploads(&drive, number) {
            all += 1;
            kept += u32::from(!matches!(map.offer(&upload), Vetted::Quarantined { .. }));
        }
    }
    let fixes = localized(&driven(&city, 3, 999, PoseError::NONE), &map, seed);
    let usable = fixes.iter().filter(|fix| fix.usable).count();
    println!("    town {seed}: {kept} of {all} uploads count, {usable} of {} fixes usable", fixes.len());
    fixes
}

fn localized(drive: &Drive, map: &CrowdMap, seed: u64) -> Vec<Fix> {
    let grid = Grid::of(drive.truth[0].at).expect("it lies on the map");
    let poses =
        drive.truth.iter().map(|p| (p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad).expect("as above")));
    let truth = Trajectory::new(poses).expect("poses in order");
    let scale = grid.scale_factor(drive.truth[0].at).expect("as above");
    let (search, integrity, engine) = (Search::default(), Integrity::default(), EngineKind::Fast.engine());
    let (mut aligner, mut fixes) = (Aligner::default(), Vec::new());
    let first_us = drive.truth[0].time_us;
    for second in 8.. {
        let time_us = first_us + second * 1_000_000;
        let Some(true_pose) = truth.at(time_us) else { break };
        if drive.odometry.velocity_at(time_us).is_none_or(|v| v.speed_mps() < 2.0) {
            continue;
        }
        let at = |time_us: i64| drive.scans.partition_point(|scan| scan.time_us <= time_us);
        let scans = &drive.scans[at(time_us - 5_000_000)..at(time_us)];
        let batch = Batch::organise(scans, &drive.mounts, &drive.odometry, time_us, &Gate::default())
            .expect("odometry covers it");
        // As good as random ones, within a sigma or two.
        let off = |k: u64| ((seed * 7919 + second as u64 * 104_729 + k * 31) % 1000) as f64 / 500.0 - 1.0;
        let mut pose = true_pose;
        (pose.x_m, pose.y_m) = (pose.x_m + 3.0 * off(1), pose.y_m + 3.0 * off(2));
        pose.yaw_rad += 0.05 * off(3);
        let prior = Prior { pose, sigma_position_m: 2.0, sigma_yaw_rad: 3_f64.to_radians(), scale };
        let position = MapPoint::of(&pose);
        let square = MapSquare::around(grid.zone(), position, search.extent_m, search.sigmas * 2.0);
        let tiles: Vec<_> = square.tiles().filter_map(|id| map.weights(id)).collect();
        let task = Task { square, tiles: &tiles, batch: &batch, prior: &prior };
        let answer = aligner.align(&task, engine, &search, &integrity);
        let off = true_pose.between(&answer.pose);
        let error = [off.x_m / scale, off.y_m / scale, wrap_angle(off.yaw_rad)];
        let levels = answer.protection(&integrity, 1e-3);
        let levels = [levels.along_m, levels.cross_m, levels.yaw_rad];
        let over = integrity.tail * (2.0 * 1000_f64.ln()).sqrt();
        let beyond = error.iter().zip(levels).any(|(error, level)| error.abs() > level);
        let usable = answer.verdict == Verdict::Usable;
        fixes.push(Fix { usable, error, sigma: levels.map(|level| level / over), beyond });
    }
    fixes
}

fn print(name: &str, fixes: &[Fix]) {
    // Whether a wrong place is called usable is another question.
    let near = |fix: &&Fix| fix.error[0].hypot(fix.error[1]) < 3.0 && fix.sigma.iter().all(|s| s.is_finite());
    let sound: Vec<&Fix> = fixes.iter().filter(near).collect();
    let mean = |of: &dyn Fn(&Fix) -> f64| sound.iter().map(|fix| of(fix)).sum::<f64>() / sound.len() as f64;
    let nees = [0, 1, 2].map(|axis| mean(&|fix| (fix.error[axis] / fix.sigma[axis]).powi(2)));
    let rms = [0, 1, 2].map(|axis| mean(&|fix| fix.error[axis].powi(2)).sqrt());
    let sigma = [0, 1, 2].map(|axis| mean(&|fix| fix.sigma[axis].powi(2)).sqrt());
    let beyond = sound.iter().filter(|fix| fix.beyond).count();
    println!(
        "{name}: NEES along {:.2} across {:.2} yaw {:.2}; beyond {beyond} of {}; rms {:.3} {:.3} m {:.3} deg; \
         sigma {:.3} {:.3} m {:.3} deg",
        nees[0],
        nees[1],
        nees[2],
        sound.len(),
        rms[0],
        rms[1],
        rms[2].to_degrees(),
        sigma[0],
        sigma[1],
        sigma[2].to_degrees(),
    );
}

fn seeds() -> Vec<u64> {
    let text = std::env::var("ECHOFIX_TOWNS").unwrap_or_else(|_| "301,302".to_owned());
    text.split(',').filter_map(|seed| seed.parse().ok()).collect()
}

/// Fixes in all towns, each in a thread.
fn everywhere(contributors: u64, error: impl Fn(u64) -> (PoseError, f64) + Sync) -> Vec<Fix> {
    let error = &error;
    std::thread::scope(|scope| {
        let towns: Vec<_> =
            seeds().into_iter().map(|seed| scope.spawn(move || fixes(seed, contributors, error))).collect();
        towns.into_iter().flat_map(|town| town.join().expect("a town")).collect()
    })
}

fn of(sigma_position_m: f64, yaw_deg: f64) -> PoseError {
    PoseError { sigma_position_m, sigma_yaw_rad: yaw_deg.to_radians(), correlation_s: 60.0 }
}

/// Prints how honest answers are on maps of poses of three grades.
#[test]
#[ignore = "minutes; a look and no check"]
fn honest_contributors() {
    for (position_m, yaw_deg) in [(0.05, 0.1), (0.1, 0.15), (0.25, 0.4)] {
        for contributors in [1, 5] {
            let fixes = everywhere(contributors, |_| (of(position_m, yaw_deg), 1.0));
            print(&format!("{position_m} m, {yaw_deg} deg, {contributors} contributors"), &fixes);
        }
    }
}

/// The same where two of five declare a fifth of the error that they have.
#[test]
#[ignore = "minutes; a look and no check"]
fn dishonest_contributors() {
    let fixes = everywhere(5, |number| if number < 2 { (of(0.3, 0.3), 0.2) } else { (of(0.1, 0.15), 1.0) });
    print("two of five lie", &fixes);
}
