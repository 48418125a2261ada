use super::*;
use crate::drivelog;
use std::fs;
use std::io::Write;

const SENSORS: &str = "sensor,x_m,y_m,yaw_rad\n0,3.5,0,0\n1,2.5,0.8,1.57\n";
const ODOMETRY: &str = "time_us,x_m,y_m,yaw_rad\n0,0,0,0\n100000,1.5,0,0\n";

fn read_files(files: &[(&str, &[u8])]) -> Result<DriveLog, Error> {
    let temporary = tempfile::tempdir().unwrap();
    // The vehicle is named after the folder.
    let dir = temporary.path().join("drive");
    fs::create_dir(&dir).unwrap();
    let defaults = [
        ("sensors.csv", SENSORS),
        ("odometry.csv", ODOMETRY),
        ("scans.csv", "time_us,sensor,range_m,azimuth_rad\n"),
    ];
    for (name, text) in defaults {
        fs::write(dir.join(name), text).unwrap();
    }
    for (name, bytes) in files {
        if let Some(plain) = name.strip_suffix(".gz") {
            fs::remove_file(dir.join(plain)).unwrap();
        }
        fs::write(dir.join(name), bytes).unwrap();
    }
    drivelog::read(&dir)
}

fn read_with(scans: &str) -> Result<DriveLog, Error> {
    read_files(&[("scans.csv", scans.as_bytes())])
}

#[test]
fn a_hand_written_folder_is_a_drive() {
    // Columns in another order, one not known, no optional ones, spaces and quotes around cells.
    let log = read_with(
        "range_m, azimuth_rad, \"sensor\", time_us, note\n1.5, 0.5, 0, 0, a\n\"2\",-0.5,0,0,b\n 3 ,0,1,0,c\n",
    )
    .unwrap();
    let drive = log.drive;
    assert_eq!(drive.scans.len(), 2);
    assert_eq!(drive.scans[0].range_m, [1.5, 2.0]);
    assert_eq!(drive.scans[1].sensor, 1);
    assert_eq!((drive.mounts.len(), drive.odometry.len()), (2, 2));
    assert!(drive.reference.is_empty() && log.flaws.is_empty());
}

/// Catches: a problem that does not say where it is, which value it is and what to do.
#[test]
fn errors_name_file_line_column_and_value() {
    let header = "time_us,sensor,range_m,azimuth_rad,radial_speed_mps,elevation_rad\n";
    for (row, words) in [
        ("0,2,1,0,,", "sensors.csv, which has 2"),
        ("0,0,-1,0,,", "distances from the sensor"),
        ("0,0,NaN,0,,", "finite"),
        ("0,0,1,,,", "both be given"),
        ("0,0,x,0,,", "column `range_m` is `x`: invalid float"),
        ("0,0,1", "fields"),
        ("nine,0,1,0,,", "column `time_us` is `nine`: invalid digit"),
        ("0,0,1,0,fast,", "column `radial_speed_mps` is `fast`"),
        ("0,0,1,0,,12.5", "elevations are radians"),
    ] {
        // Alone it is an error; among others it is skipped, and told in the same words.
        let message = read_with(&format!("{header}{row}\n")).unwrap_err().to_string();
        assert!(message.contains("scans.csv line 2") && message.contains(words), "{message}");
        let log = read_with(&format!("{header}0,0,1,0,,\n{row}\n0,0,2,0,,\n")).unwrap();
        assert_eq!((log.drive.scans[0].len(), log.flaws.total()), (2, 1), "{row}: {}", log.flaws);
        let told = log.flaws.to_string();
        assert!(told.contains("first at scans.csv:3") && told.contains(words), "{told}");
    }
    let error = read_with("time_us,sensor\n0,0\n").unwrap_err();
    assert!(error.to_string().contains("line 1: column `range_m` is missing"), "{error}");
    let sensors = read_files(&[("sensors.csv", b"sensor,x_m,y_m,yaw_rad\n0,3.5,left,0\n")]).unwrap_err();
    assert!(sensors.to_string().contains("column `y_m` is `left`"), "{sensors}");
}

/// Catches: one bad record that ends the drive or takes others with it, and one that is dropped without a word.
#[test]
fn nothing_is_lost_for_one_bad_record() {
    let rows = |header: &str, row: &dyn Fn(i64) -> String| -> Vec<String> {
        std::iter::once(header.to_owned()).chain((0..50).map(row)).collect()
    };
    let t = |i: i64| 1_700_000_000_000_000 + 100_000 * i;
    let scans =
        rows("time_us,sensor,range_m,azimuth_rad,rcs_dbsm", &|i| format!("{},0,{},0.1,nan", t(i), 10 + i));
    let odometry = rows("time_us,x_m,y_m,yaw_rad", &|i| format!("{},{i},0,0", t(i)));
    let poses = rows(&super::super::GEODETIC.join(","), &|i| format!("{},48.1,11.{i},0.5,0.1,0.01", t(i)));
    let garbage = "\"\0\u{fffd}#garbage, \"mid-file";
    let day = 86_400_000_000;
    for (reason, in_scans, in_odometry, in_poses) in [
        ("unreadable", garbage.to_owned(), garbage.to_owned(), garbage.to_owned()),
        ("unreadable", "0".repeat(100_000), "\0".repeat(100_000), "1,2".to_owned()),
        ("doubled", scans[25].clone(), odometry[25].clone(), poses[25].clone()),
        (
            "not_finite",
            format!("{},0,NaN,NaN,NaN", t(24)),
            format!("{},NaN,0,0", t(24)),
            format!("{},48.1,nan,0,0.1,0", t(24)),
        ),
        ("out_of_range", format!("{},0,-3,0,", t(24)), String::new(), format!("{},200,11,0,0.1,0", t(24))),
        (
            "out_of_order",
            String::new(),
            format!("{},24,0,0", t(24) - day),
            format!("{},48.1,11.5,0,0.1,0", t(24) - day),
        ),
    ] {
        let with = |rows: &[String], row: &str| {
            let mut rows = rows.to_vec();
            if !row.is_empty() {
                rows.insert(26, row.to_owned());
            }
            // The last record is cut off.
            rows.join("\n") + "\n170000"
        };
        let (a, b, c) = (with(&scans, &in_scans), with(&odometry, &in_odometry), with(&poses, &in_poses));
        let log = read_files(&[
            ("scans.csv", a.as_bytes()),
            ("odometry.csv", b.as_bytes()),
            ("reference.csv", c.as_bytes()),
        ]);
        let DriveLog { drive, flaws } = log.unwrap();
        assert_eq!(
            (drive.scans.len(), drive.odometry.len(), drive.reference.len()),
            (50, 50, 50),
            "{reason}: {flaws}"
        );
        for (part, row) in
            [("scans.csv", &in_scans), ("odometry.csv", &in_odometry), ("reference.csv", &in_poses)]
        {
            let told = flaws.skipped.iter().any(|s| s.part == part && s.reason == reason && s.first == 27);
            assert!(told || row.is_empty(), "{part} {reason}: {flaws}");
            assert!(flaws.skipped.iter().any(|s| s.part == part && s.reason == "unreadable"), "{flaws}");
        }
        assert!(drive.scans.iter().all(|scan| scan.rcs_dbsm.is_empty()));
    }
}

/// Catches: rows of a scan that stand apart and become scans of their own, or count twice.
#[test]
fn rows_of_a_scan_belong_together_wherever_they_stand() {
    let log = read_with(
        "time_us,sensor,range_m,azimuth_rad\n0,0,1,0\n0,1,9,0\n0,0,2,0\n50,0,5,0\n0,0,1,0\n0,0,3,0\n30,0,,\n30,0,,\n",
    )
    .unwrap();
    let ranges: Vec<_> = log.drive.scans.iter().map(|scan| &scan.range_m[..]).collect();
    assert_eq!(ranges, [&[1.0, 2.0, 3.0][..], &[9.0], &[], &[5.0]]);
    assert_eq!((log.flaws.count("doubled"), log.flaws.total()), (2, 2), "{}", log.flaws);
}

/// Catches: times in another unit that are read as microseconds, without a word.
#[test]
fn times_in_other_units_are_recognised_and_told() {
    let odometry = |header: &str, times: [&str; 3]| {
        let rows: Vec<_> = times.iter().map(|time| format!("{time},0,0,0")).collect();
        let text = format!("{header},x_m,y_m,yaw_rad\n{}\n", rows.join("\n"));
        let DriveLog { drive, flaws } = read_files(&[("odometry.csv", text.as_bytes())]).unwrap();
        (drive.odometry.iter().map(|(time_us, _)| time_us).collect::<Vec<_>>(), flaws.to_string())
    };
    let expected = [1_700_000_000_000_000, 1_700_000_000_050_000, 1_700_000_000_100_000];
    for (unit, header, times) in [
        ("nanoseconds", "time_us", ["1700000000000000000", "1700000000050000000", "1700000000100000000"]),
        ("milliseconds", "time_us", ["1700000000000", "1700000000050", "1700000000100.0"]),
        ("seconds", "time_us", ["1700000000", "1700000000.05", "1.7000000001e9"]),
        ("seconds", "time_s", ["1700000000", "1700000000.05", "1700000000.1"]),
    ] {
        let (read, told) = odometry(header, times);
        assert_eq!(read, expected, "{unit}");
        assert!(told.contains(&format!("odometry.csv: times are in {unit}")), "{told}");
    }
    let (read, told) = odometry("time_us", ["1700000000000000.0", "1700000000050000", "1700000000100000"]);
    assert_eq!((read, told), (expected.to_vec(), String::new()));
}

/// Catches: a packed file that a power cut left short, and that takes all of the drive with it.
#[test]
fn what_comes_before_the_end_of_a_torn_file_is_read() {
    let mut text = b"time_us,sensor,range_m,azimuth_rad\n".to_vec();
    for i in 0..5000_i64 {
        writeln!(text, "{},0,{},0.1", 50_000 * i, 1.0 + (i * i % 977) as f64 * 0.037).unwrap();
    }
    let mut gz = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    gz.write_all(&text).unwrap();
    let packed = gz.finish().unwrap();
    let log = read_files(&[("scans.csv.gz", &packed[..packed.len() / 2])]).unwrap();
    assert!(log.drive.scans.len() > 1000, "{}", log.drive.scans.len());
    assert_eq!(log.flaws.count("cut_off"), 1, "{}", log.flaws);
}

/// Catches: one row of `sensors.csv` that is doubled, swapped or garbage and ends the drive, and two places of one radar of which
/// one is taken.
#[test]
fn sensors_stand_in_any_order_and_one_bad_row_ends_nothing() {
    let with =
        |rows: &str| read_files(&[("sensors.csv", format!("sensor,x_m,y_m,yaw_rad\n{rows}").as_bytes())]);
    let (clean, rows) = (with("0,3.5,0,0\n1,2.5,0.8,1.57\n").unwrap(), "1,2.5,0.8,1.57\n0,3.5,0,0\n");
    assert_eq!(with(rows).unwrap(), clean);
    for (more, reason) in
        [("0,3.5,0,0\n", "doubled"), ("rear,1,2,3\n", "unreadable"), ("2,nan,0,0\n", "not_finite")]
    {
        let log = with(&format!("{rows}{more}")).unwrap();
        assert_eq!(log.drive, clean.drive);
        assert_eq!((log.flaws.count(reason), log.flaws.total()), (1, 1), "{}", log.flaws);
    }
    for (rows, words) in [
        ("0,3.5,0,0\n0,3.6,0,0\n", "sensor 0 stands there twice"),
        ("1,3.5,0,0\n", "expected sensor 0"),
        ("0,front,0,0\n1,3.5,0,0\n", "line 2: column `x_m` is `front`"),
    ] {
        let told = with(rows).unwrap_err().to_string();
        assert!(told.contains(words) && told.contains("sensors.csv"), "{told}");
    }
}

/// Catches: a log of a writer that ends rows with a comma, knows only fractions, or shouts; and one whose cells are separated otherwise,
/// of which only a column is said to be missing.
#[test]
fn writers_have_their_ways() {
    let rows = |end: &str, sensor: &str| {
        format!("TIME_US,Sensor,range_m,azimuth_rad\n0,{sensor},1,0{end}\n0,{sensor},2,0{end}\n")
    };
    let clean = read_with(&rows("", "1").to_lowercase()).unwrap();
    for (end, sensor) in [("", "1"), (",", "1"), (", ,", "1.0"), ("", "1.")] {
        let log = read_with(&rows(end, sensor)).unwrap();
        assert!(log == clean && clean.drive.scans[0].len() == 2, "{end} {sensor}: {}", log.flaws);
    }
    assert_eq!(read_with(&(rows("", "1") + "0,1,3,0,9\n")).unwrap().flaws.count("unreadable"), 1);
    let told = read_with("time_us;sensor;range_m;azimuth_rad\n0;1;1;0\n").unwrap_err().to_string();
    assert!(told.contains("separated by ';'"), "{told}");
}
