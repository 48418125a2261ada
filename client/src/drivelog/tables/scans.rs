//! The rows of `scans.csv`, joined to scans.

use std::collections::{HashMap, HashSet, VecDeque};

use echofix_core::scan::Scan;

use super::super::scans::{NO_OFFSET, ReadScans};
use super::super::{Error, Flaws, Problem};
use super::cells::Cells;
use super::table::Table;

/// Scans whose rows are remembered, to tell doubled ones: those of some vehicle's radars at a time.
const REMEMBERED: usize = 32;

/// Reads the scans of a vehicle with so many sensors.
pub(super) fn read(table: &Table, sensors: usize, flaws: &mut Flaws) -> Result<Vec<Scan>, Error> {
    let mut joiner = Joiner::default();
    table.records(&super::SCANS_IN_SPACE, 4, flaws, |cells, line| {
        let detection = Detection::of(cells)?;
        if detection.sensor >= sensors {
            return Err(Problem::UnknownSensor { sensor: detection.sensor, sensors });
        }
        joiner.add(&detection, line)
    })?;
    Ok(ReadScans { part: &table.name(), scans: joiner.scans }.finish(flaws))
}

struct Detection {
    time_us: i64,
    sensor: usize,
    /// Range and azimuth; `None` for a scan that detected nothing.
    at: Option<[f32; 2]>,
    radial_speed_mps: f32,
    rcs_dbsm: f32,
    elevation_rad: f32,
    offset_us: i32,
}

impl Detection {
    fn of(cells: &Cells) -> Result<Self, Problem> {
        let number = |column| Ok::<_, Problem>(cells.optional(column)?.unwrap_or(f32::NAN));
        let at = match (cells.given::<f32>(2)?, cells.given::<f32>(3)?) {
            (Some(range_m), Some(azimuth_rad)) => Some([range_m, azimuth_rad]),
            (None, None) => None,
            _ => return Err(Problem::HalfADetection),
        };
        let detection = Self {
            time_us: cells.time_us()?,
            sensor: cells.index(1)?,
            at,
            radial_speed_mps: number(4)?,
            rcs_dbsm: number(5)?,
            elevation_rad: number(6)?,
            offset_us: cells.optional(7)?.unwrap_or(NO_OFFSET),
        };
        if let Some([range_m, azimuth_rad]) = at {
            if !(range_m.is_finite() && azimuth_rad.is_finite()) {
                return Err(Problem::NotFinite);
            }
            if range_m < 0.0 {
                return Err(Problem::NegativeRange { range_m });
            }
        }
        if detection.elevation_rad.abs() > std::f32::consts::FRAC_PI_2 {
            return Err(Problem::NoElevation { elevation_rad: detection.elevation_rad });
        }
        Ok(detection)
    }
}

/// The values of a detection, to compare.
type Bits = [u32; 6];

/// Joins rows of the same time and sensor, wherever they stand.
#[derive(Default)]
struct Joiner {
    /// With the line of their first row.
    scans: Vec<(Scan, u64)>,
    of: HashMap<(i64, usize), usize>,
    /// Rows of the scans that were added to lately.
    seen: VecDeque<(usize, HashSet<Bits>)>,
}

impl Joiner {
    fn add(&mut self, detection: &Detection, line: u64) -> Result<(), Problem> {
        let Detection { time_us, sensor, .. } = *detection;
        let scans = &mut self.scans;
        let known = self.of.get(&(time_us, sensor)).copied();
        let index = known.unwrap_or_else(|| {
            scans.push((Scan { sensor, time_us, ..Scan::default() }, line));
            self.of.insert((time_us, sensor), scans.len() - 1);
            scans.len() - 1
        });
        let Some([range_m, azimuth_rad]) = detection.at else {
            let stands_alone = scans[index].0.is_empty();
            return match known {
                Some(_) if stands_alone => Err(Problem::Doubled),
                Some(_) => Err(Problem::HalfADetection),
                None => Ok(()),
            };
        };
        let scan = &mut scans[index].0;
        let values =
            [range_m, azimuth_rad, detection.radial_speed_mps, detection.rcs_dbsm, detection.elevation_rad];
        if !rows_of(&mut self.seen, index, scan).insert(bits(values, detection.offset_us)) {
            return Err(Problem::Doubled);
        }
        scan.range_m.push(range_m);
        scan.azimuth_rad.push(azimuth_rad);
        scan.radial_speed_mps.push(detection.radial_speed_mps);
        scan.rcs_dbsm.push(detection.rcs_dbsm);
        scan.elevation_rad.push(detection.elevation_rad);
        scan.detection_time_offset_us.push(detection.offset_us);
        Ok(())
    }
}

/// The rows of a scan that is added to.
fn rows_of<'a>(
    seen: &'a mut VecDeque<(usize, HashSet<Bits>)>,
    index: usize,
    scan: &Scan,
) -> &'a mut HashSet<Bits> {
    let at = seen.iter().rposition(|(of, _)| *of == index).unwrap_or_else(|| {
        if seen.len() == REMEMBERED {
            seen.pop_front();
        }
        let row = |row: usize| {
            let values = [
                &scan.range_m,
                &scan.azimuth_rad,
                &scan.radial_speed_mps,
                &scan.rcs_dbsm,
                &scan.elevation_rad,
            ];
            bits(values.map(|column| column[row]), scan.detection_time_offset_us[row])
        };
        seen.push_back((index, (0..scan.len()).map(row).collect()));
        seen.len() - 1
    });
    &mut seen[at].1
}

fn bits(values: [f32; 5], offset_us: i32) -> Bits {
    let [range, azimuth, speed, rcs, elevation] = values.map(f32::to_bits);
    [range, azimuth, speed, rcs, elevation, offset_us.cast_unsigned()]
}
