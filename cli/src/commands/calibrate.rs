//! `echofix calibrate`: mounts and clocks of a recorded drive.

mod plot;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use echofix_core::calibration::{
    CalibrationConfig, CalibrationSigma, Estimated, RadarCalibration, SelfCalibration,
};
use echofix_core::drive::Drive;
use echofix_core::scan::Mount;
use serde_json::{Value, json};

/// Arguments of `echofix calibrate`.
#[derive(clap::Args)]
pub struct Args {
    /// Drive logs of one vehicle: .mcap files or folders of CSV files.
    #[arg(required = true)]
    drives: Vec<PathBuf>,
    /// Write a plot of clock and yaw over the drive to this SVG file.
    #[arg(long)]
    plot: Option<PathBuf>,
}

/// A drive that leaves more open than this says too little of a clock (seconds), of a yaw (radians).
const ENOUGH: CalibrationSigma =
    CalibrationSigma { late_s: 0.02, yaw_rad: 0.01, forward_m: f64::INFINITY, left_m: f64::INFINITY };
/// Scans between two looks at the estimate, for the plot.
const SCANS_A_LOOK: usize = 600;
/// Stretches remembered: all of a long day's.
const ALL_STRETCHES: usize = 20_000;

/// Runs the subcommand.
///
/// # Errors
/// When a log cannot be read, the logs are of different vehicles, or they say too little.
pub fn run(args: &Args, json: bool) -> anyhow::Result<()> {
    let drives = args.drives.iter().map(|path| read(path)).collect::<anyhow::Result<Vec<_>>>()?;
    let mounts = same_mounts(&drives)?;
    let (found, history) = calibrated(&drives, &mounts);
    let radars = enough(&drives, &found)?;
    if let Some(plot) = &args.plot {
        plot::write(plot, &history).with_context(|| format!("writing {}", plot.display()))?;
    }
    if json {
        let radars: Vec<_> = radars.iter().map(|(i, radar)| as_json(*i, &mounts[*i], radar)).collect();
        println!("{}", json!({ "radars": radars }));
    } else {
        print_table(&mounts, &radars);
    }
    Ok(())
}

fn read(path: &Path) -> anyhow::Result<Drive> {
    let (drive, flaws) = super::drive_of(path, None)?;
    super::tell(&flaws);
    Ok(drive)
}

fn same_mounts(drives: &[Drive]) -> anyhow::Result<Vec<Mount>> {
    let mounts = drives.first().map(|drive| drive.mounts.clone()).unwrap_or_default();
    if drives.iter().any(|drive| drive.mounts != mounts) {
        bail!("the logs have different mounts; calibrate each vehicle by itself");
    }
    Ok(mounts)
}

/// What was known of a radar at a time of the drive.
struct Look {
    sensor: usize,
    /// Seconds of driving that it rests on.
    driven_s: f64,
    found: RadarCalibration,
}

/// The radars at the end, and on the way there.
fn calibrated(drives: &[Drive], mounts: &[Mount]) -> (Vec<Option<RadarCalibration>>, Vec<Look>) {
    let config = CalibrationConfig { stretches: ALL_STRETCHES, ..CalibrationConfig::default() };
    let mut calibration = SelfCalibration::new(config, mounts);
    let (mut looks, mut taken) = (Vec::new(), 0_usize);
    for drive in drives {
        for scan in &drive.scans {
            if !calibration.add(scan, &drive.odometry) {
                continue;
            }
            taken += 1;
            if taken.is_multiple_of(SCANS_A_LOOK) {
                let look = |sensor: usize| {
                    let found = calibration.radar(sensor)?;
                    Some(Look { sensor, driven_s: found.driven_s, found })
                };
                looks.extend((0..mounts.len()).filter_map(look));
            }
        }
    }
    ((0..mounts.len()).map(|sensor| calibration.radar(sensor)).collect(), looks)
}

/// The radars of which the drives say enough, with their numbers.
///
/// # Errors
/// Why they say enough of none.
fn enough(
    drives: &[Drive],
    found: &[Option<RadarCalibration>],
) -> anyhow::Result<Vec<(usize, RadarCalibration)>> {
    if drives.iter().all(|drive| drive.scans.iter().all(|scan| scan.radial_speed_mps.is_empty())) {
        bail!("the radars measured no radial speeds; mounts and clocks cannot be told from this log");
    }
    if drives.iter().all(|drive| drive.odometry.len() < 2) {
        bail!("the log holds no odometry; mounts and clocks are estimated against it");
    }
    let all: Vec<_> = found.iter().enumerate().filter_map(|(i, radar)| Some((i, (*radar)?))).collect();
    let Some(longest_s) = all.iter().map(|(_, radar)| radar.driven_s).max_by(f64::total_cmp) else {
        bail!(
            "no scan fits the odometry: too few stationary returns while driving; is the radial speed positive away?"
        );
    };
    let known = |radar: &RadarCalibration| {
        radar.late_s.sigma <= ENOUGH.late_s && radar.yaw_rad.sigma <= ENOUGH.yaw_rad
    };
    if let Some((_, best)) = all.iter().min_by(|a, b| a.1.late_s.sigma.total_cmp(&b.1.late_s.sigma))
        && !all.iter().any(|(_, radar)| known(radar))
    {
        bail!(
            "the drive says too little: the clock is known to {:.0} ms and the yaw to {:.2} degrees after {longest_s:.0} s of \
             driving; record some minutes with stops, starts and turns",
            1e3 * best.late_s.sigma,
            best.yaw_rad.sigma.to_degrees()
        );
    }
    Ok(all)
}

fn as_json(sensor: usize, built: &Mount, radar: &RadarCalibration) -> Value {
    let mount = radar.mount(built);
    let number = |e: Estimated| json!({ "value": e.value, "sigma": e.sigma });
    json!({
        "sensor": sensor,
        "late_s": number(radar.late_s),
        "yaw_off_rad": number(radar.yaw_rad),
        "forward_off_m": number(radar.forward_m),
        "left_off_m": number(radar.left_m),
        "mount": { "x_m": mount.x_m, "y_m": mount.y_m, "yaw_rad": mount.yaw_rad },
        "scans": radar.scans,
        "driven_s": radar.driven_s,
    })
}

fn print_table(mounts: &[Mount], radars: &[(usize, RadarCalibration)]) {
    println!(
        "{:<6} {:>18} {:>20} {:>20} {:>20} {:>7}",
        "radar", "clock late, ms", "yaw off, deg", "forward off, m", "left off, m", "scans"
    );
    for (sensor, radar) in radars {
        let cell = |e: Estimated, unit: f64, digits: usize| {
            let marked = if e.is_beyond(3.0) { '*' } else { ' ' };
            format!("{:.digits$} +- {:.digits$}{marked}", e.value * unit, e.sigma * unit)
        };
        println!(
            "{sensor:<6} {:>18} {:>20} {:>20} {:>20} {:>7}",
            cell(radar.late_s, 1e3, 1),
            cell(radar.yaw_rad, 1_f64.to_degrees(), 3),
            cell(radar.forward_m, 1.0, 3),
            cell(radar.left_m, 1.0, 3),
            radar.scans
        );
    }
    println!(
        "* more than three sigmas: the mount or the clock is off. Corrected, in the log's own convention:"
    );
    for (sensor, radar) in radars {
        let Mount { x_m, y_m, yaw_rad } = radar.mount(&mounts[*sensor]);
        println!(
            "{sensor:<6} x {x_m:.3} m   y {y_m:.3} m   yaw {:.3} deg   stamps {:+.1} ms",
            yaw_rad.to_degrees(),
            -1e3 * radar.late_s.value
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_client::drivelog;
    use echofix_sim::{City, CityParams, DriveParams, Route, simulate};

    /// A simulated drive of some seconds whose first radar is turned by 2 degrees, all clocks 50 ms late.
    fn drive(seconds: f64) -> Drive {
        let city = City::generate(&CityParams::default()).unwrap();
        let params = DriveParams { max_duration_s: seconds, ..DriveParams::default() };
        let mut drive = simulate(&city.on_day(0), &Route::wander(&city, 3, 12.0 * seconds), &params).unwrap();
        drive.mounts[0].yaw_rad -= 2_f64.to_radians();
        drive.scans.iter_mut().for_each(|scan| scan.time_us += 50_000);
        drive
    }

    fn run_on(drive: &Drive, folder: &Path) -> anyhow::Result<()> {
        let (log, plot) = (folder.join("drive.mcap"), folder.join("plot.svg"));
        drivelog::write(&log, drive)?;
        run(&Args { drives: vec![log], plot: Some(plot) }, true)
    }

    /// Catches: a log that cannot be calibrated from its file, and a plot that is not written.
    #[test]
    fn a_late_clock_and_a_turned_radar_are_found_in_a_log() {
        let (folder, drive) = (tempfile::tempdir().unwrap(), drive(120.0));
        run_on(&drive, folder.path()).unwrap();
        let svg = std::fs::read_to_string(folder.path().join("plot.svg")).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("polyline") && svg.ends_with("</svg>\n"));
        let (found, _) = calibrated(std::slice::from_ref(&drive), &drive.mounts);
        let radars = enough(std::slice::from_ref(&drive), &found).unwrap();
        for (sensor, radar) in radars {
            let turned_deg = if sensor == 0 { 2.0 } else { 0.0 };
            assert!((radar.late_s.value - 0.05).abs() < 0.005, "{radar:?}");
            assert!((radar.yaw_rad.value.to_degrees() - turned_deg).abs() < 0.1, "{radar:?}");
        }
    }

    /// Catches: figures printed where the drive holds none.
    #[test]
    fn a_drive_that_says_too_little_is_told_so() {
        let folder = tempfile::tempdir().unwrap();
        let told = |drive: &Drive| run_on(drive, folder.path()).unwrap_err().to_string();
        assert!(told(&drive(1.5)).contains("while driving"));
        let mut silent = drive(20.0);
        let mut still = silent.clone();
        silent.scans.iter_mut().for_each(|scan| scan.radial_speed_mps.clear());
        assert!(told(&silent).contains("no radial speeds"), "{}", told(&silent));
        let until_us = still.scans[0].time_us + 3_000_000;
        still.scans.retain(|scan| scan.time_us < until_us);
        assert!(told(&still).contains("too little"), "{}", told(&still));
    }
}
