//! What a drive costs and holds: `cargo run -p echofix-sim --example measure`.
#![expect(clippy::print_stdout, reason = "printing is what this program is for")]

use std::collections::BTreeSet;
use std::time::Instant;

use echofix_core::drive::Drive;
use echofix_core::gate::Gate;
use echofix_core::geo::CellIndex;
use echofix_sim::{City, CityParams, DriveParams, Error, Route, simulate};

fn main() -> Result<(), Error> {
    let started = Instant::now();
    let city = City::generate(&CityParams::default())?;
    let structure = city.structure();
    println!(
        "streets {:.0} m, {} walls, {} reflectors",
        city.streets_m(),
        structure.walls.len(),
        structure.reflectors.len()
    );
    let day = city.on_day(1);
    println!(
        "{} of {} slots taken, {} vehicles moving",
        day.parked().len(),
        city.slots().len(),
        day.movers(0).count()
    );
    println!("city and day: {:.0} ms", 1e3 * started.elapsed().as_secs_f64());

    let started = Instant::now();
    let route = Route::survey(&city, 1);
    let drive = simulate(&day, &route, &DriveParams::default())?;
    let took_s = started.elapsed().as_secs_f64();
    let km = 1e-3 * route.length_m();
    println!(
        "survey {km:.2} km, {:.0} s driven, {took_s:.2} s to make, {:.2} s per km",
        0.02 * drive.odometry.len() as f64,
        took_s / km
    );
    for sensor in 0..drive.mounts.len() {
        let scans: Vec<_> = drive.scans.iter().filter(|s| s.sensor == sensor).collect();
        let mean = |count: &dyn Fn(f32) -> bool| {
            let total: usize = scans.iter().map(|s| s.range_m.iter().filter(|r| count(**r)).count()).sum();
            total as f64 / scans.len() as f64
        };
        let full = scans.iter().filter(|s| s.len() >= 64).count();
        println!(
            "sensor {sensor}: {:.1} detections per scan, {:.1} within 50 m, {full} of {} scans full",
            mean(&|_| true),
            mean(&|r| r < 50.0),
            scans.len()
        );
    }
    batches(&drive);
    Ok(())
}

/// Occupied cells of 5 s batches after gating by speed and range, by mean speed.
fn batches(drive: &Drive) {
    let gate = Gate::default();
    let (first_us, last_us) = (drive.scans[0].time_us, drive.scans[drive.scans.len() - 1].time_us);
    let mut rows = Vec::new();
    for start_us in (first_us..last_us - 5_000_000).step_by(5_000_000) {
        let mut cells = BTreeSet::new();
        let (mut hits, mut way_m, mut gated) = (0, 0.0, 0);
        let from = drive.scans.partition_point(|s| s.time_us < start_us);
        for scan in drive.scans[from..].iter().take_while(|s| s.time_us < start_us + 5_000_000) {
            let (Some(pose), Some(speed)) =
                (drive.odometry.at(scan.time_us), drive.odometry.velocity_at(scan.time_us))
            else {
                continue;
            };
            way_m += speed.speed_mps() / 12.0 / 5.0;
            if speed.speed_mps() < gate.min_speed_mps {
                gated += 1;
                continue;
            }
            let sensor = pose.compose(&drive.mounts[scan.sensor]);
            for row in (0..scan.len()).filter(|row| f64::from(scan.range_m[*row]) < gate.max_range_m) {
                cells.insert(CellIndex::of(sensor.transform(scan.sensor_point(row)).into()));
                hits += 1;
            }
        }
        rows.push((way_m / 5.0, cells.len(), hits, gated));
    }
    let whole: Vec<_> = rows.iter().filter(|r| r.3 == 0).collect();
    let mut counts: Vec<_> = whole.iter().map(|r| r.1).collect();
    counts.sort_unstable();
    if let (Some(low), Some(high)) = (counts.first(), counts.last()) {
        println!(
            "{} batches of 5 s without a stop: cells {low} .. median {} .. {high}",
            counts.len(),
            counts[counts.len() / 2]
        );
    }
    for row in whole.iter().step_by(whole.len().div_ceil(8)) {
        println!("  {:.1} m/s: {} hits, {} cells", row.0, row.2, row.1);
    }
}
