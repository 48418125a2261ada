//! Scans and poses become an evidence delta.

use std::collections::BTreeMap;

use super::view::Views;
use super::{CellHits, EvidenceDelta, OFFSET_STEPS, SENT_STEPS, TileEvidence};
use crate::gate::{self, Dropped, Gate};
use crate::geo::{CELL_M, CellIndex, TileId, Zone};
use crate::odometry::Trajectory;
use crate::point::MapPoint;
use crate::scan::{Mount, Scan};

/// Accumulates the evidence of an upload, part by part: into how many parts a drive is split, and in
/// which order they come, does not matter.
#[derive(Debug)]
pub struct EvidenceAccumulator {
    tiles: BTreeMap<TileId, BTreeMap<u32, CellHits>>,
    views: Views,
    steps: u32,
}

impl Default for EvidenceAccumulator {
    fn default() -> Self {
        Self::with_steps(SENT_STEPS)
    }
}

impl EvidenceAccumulator {
    /// One that resolves the position of a hit within its cell to so many steps along each side, at most
    /// [`OFFSET_STEPS`]: its hits lie in the steps' middles.
    #[must_use]
    pub fn with_steps(steps: u32) -> Self {
        let steps = steps.clamp(1, OFFSET_STEPS);
        Self { tiles: BTreeMap::new(), views: Views::default(), steps }
    }

    /// Projects scans onto the map of one zone: `poses` are body poses on the zone's grid and `scale` its
    /// point scale factor there. Returns the number of detections that count, and those dropped.
    ///
    /// # Errors
    /// When a scan names an unknown sensor.
    pub fn add(
        &mut self,
        zone: Zone,
        scans: &[Scan],
        mounts: &[Mount],
        poses: &Trajectory,
        scale: f64,
        gate: &Gate,
    ) -> Result<(u64, Dropped), gate::UnknownSensor> {
        let mut counted = 0;
        let dropped = gate::for_each_gated_scan(scans, mounts, poses, gate, |scan| {
            let sensor = scan.sensor(scale);
            scan.points_on_map(scale).for_each(|point| self.hit(zone, point));
            self.views.see(zone, MapPoint::of(&sensor), scan.points_on_map(scale));
            counted += scan.points.len() as u64;
        })?;
        Ok((counted, dropped))
    }

    fn hit(&mut self, zone: Zone, point: MapPoint) {
        let cell = CellIndex::of(point);
        let (tile, index) = TileId::locate(zone, cell);
        let steps = self.steps;
        let offset = |value: f64, cell: i64| {
            let fraction = value / CELL_M - cell as f64;
            let step = ((fraction * f64::from(steps)) as u32).min(steps - 1);
            (2 * step + 1) * OFFSET_STEPS / (2 * steps)
        };
        let entry = self.tiles.entry(tile).or_default().entry(index).or_insert(CellHits {
            index,
            hits: 0,
            offset_sum: [0, 0],
        });
        entry.hits += 1;
        entry.offset_sum[0] += offset(point.x_m, cell.x);
        entry.offset_sum[1] += offset(point.y_m, cell.y);
    }

    /// Tiles in which something was hit so far.
    #[must_use]
    pub fn tiles(&self) -> usize {
        self.tiles.len()
    }

    /// The delta; `detections` are those that count, each in one zone only.
    #[must_use]
    pub fn finish(self, detections: u64) -> EvidenceDelta {
        let mut observed = self.views.observed(|id| self.tiles.contains_key(id));
        let evidence = |(id, cells): (TileId, BTreeMap<u32, CellHits>)| {
            let mut evidence = TileEvidence::of_hits(cells.into_values().collect());
            evidence.observed = evidence.observed.union(&observed.remove(&id).unwrap_or_default());
            (id, evidence)
        };
        EvidenceDelta { tiles: self.tiles.into_iter().map(evidence).collect(), detections }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::{VIEW_BLOCK_CELLS, view_block};
    use crate::pose::Pose2;
    use proptest::prelude::*;

    fn zone() -> Zone {
        Zone::from_epsg(32614).unwrap()
    }

    /// What scans of one zone contribute, and what was left out.
    fn contribute(scans: &[Scan], scale: f64) -> (EvidenceDelta, Dropped) {
        let mut accumulator = EvidenceAccumulator::default();
        let (mounts, gate) = ([Mount::IDENTITY], Gate::default());
        let (counted, dropped) = accumulator.add(zone(), scans, &mounts, &eastward(), scale, &gate).unwrap();
        (accumulator.finish(counted), dropped)
    }

    /// East at 10 m/s from (600000, 3300000), a pose every 100 ms.
    fn eastward() -> Trajectory {
        let pose = |i: i64| Pose2::new(600_000.0 + i as f64, 3_300_000.0, 0.0);
        Trajectory::new((0..=100).map(|i| (i * 100_000, pose(i)))).unwrap()
    }

    proptest! {
        #[test]
        fn every_detection_lands_in_the_cell_below_it(
            x in 600_000.0..600_200.0_f64, y in 3_300_000.0..3_300_200.0_f64, steps in 1..=OFFSET_STEPS,
        ) {
            let mut accumulator = EvidenceAccumulator::with_steps(steps);
            accumulator.hit(zone(), MapPoint::new(x, y));
            let contribution = accumulator.finish(1);
            let (id, evidence) = contribution.tiles.first_key_value().unwrap();
            let hit = evidence.cells[0];
            let (MapPoint { x_m: x0, y_m: y0 }, [fx, fy]) = (id.origin(), hit.centroid());
            let (cx, cy) = (hit.index % 512, hit.index / 512);
            let near_m = CELL_M * (0.5 / f64::from(steps) + 1.0 / f64::from(OFFSET_STEPS)) + 1e-6;
            prop_assert!((x0 + (f64::from(cx) + fx) * CELL_M - x).abs() < near_m);
            prop_assert!((y0 + (f64::from(cy) + fy) * CELL_M - y).abs() < near_m);
            prop_assert!(evidence.observed.contains(view_block(hit.index)));
        }

        /// Fails when what was in view is counted scan by scan, or part by part.
        #[test]
        fn the_cut_into_parts_does_not_matter(
            rows in prop::collection::vec((0..100_i64, 2.0..45.0_f32, -3.0..3.0_f32), 1..200), cut in 0..100_i64,
        ) {
            let scan = |time: i64| {
                let seen = || rows.iter().filter(move |row| row.0 == time);
                Scan {
                    time_us: time * 100_000,
                    range_m: seen().map(|row| row.1).collect(),
                    azimuth_rad: seen().map(|row| row.2).collect(),
                    ..Scan::default()
                }
            };
            let scans: Vec<Scan> = (0..100).map(scan).collect();
            let (poses, mounts, gate) = (eastward(), [Mount::IDENTITY], Gate::default());
            let (whole, _) = contribute(&scans, 1.0);
            let mut accumulator = EvidenceAccumulator::default();
            let (early, late) = scans.split_at(cut as usize);
            for part in [late, early] {
                accumulator.add(zone(), part, &mounts, &poses, 1.0, &gate).unwrap();
            }
            prop_assert_eq!(accumulator.tiles(), whole.tiles.len());
            prop_assert_eq!(accumulator.finish(rows.len() as u64), whole);
        }
    }

    /// Two detections of the same post, a second apart in one scan. Catches evidence that places them from one pose, and
    /// evidence that changes by times that are all zero.
    #[test]
    fn detections_of_one_scan_are_placed_from_where_each_was_taken() {
        let scan = |offsets: Vec<i32>| Scan {
            time_us: 1_000_000,
            range_m: vec![30.0, 20.0],
            azimuth_rad: vec![0.0; 2],
            detection_time_offset_us: offsets,
            ..Scan::default()
        };
        let cells = |delta: &EvidenceDelta| delta.tiles.values().map(|tile| tile.cells.len()).sum::<usize>();
        let (timed, _) = contribute(&[scan(vec![0, 1_000_000])], 1.0);
        let (plain, _) = contribute(&[scan(vec![])], 1.0);
        assert_eq!((cells(&timed), cells(&plain)), (1, 2));
        assert_eq!(contribute(&[scan(vec![0, 0])], 1.0).0, plain);
    }

    #[test]
    fn scans_become_cells_with_the_grids_scale_applied() {
        let scan = Scan {
            time_us: 100_000,
            range_m: vec![40.0, 40.0, 80.0],
            azimuth_rad: vec![0.0; 3],
            ..Scan::default()
        };
        let (contribution, dropped) = contribute(&[scan], 0.9996);
        assert_eq!((contribution.detections, dropped.too_far), (2, 1));
        let (id, evidence) = contribution.tiles.first_key_value().unwrap();
        assert_eq!((evidence.cells.len(), evidence.cells[0].hits, evidence.detections()), (1, 2, 2));
        // 600001 + 40 * 0.9996 = 600040.984
        let x = id.origin().x_m + f64::from(evidence.cells[0].index % 512) * CELL_M;
        assert!((x - 600_040.9).abs() < 1e-6, "{x}");
    }

    /// Along a wall 20 m to the north. Fails when a ray goes on behind its return, or is not followed.
    #[test]
    fn what_lies_before_the_returns_was_in_view_and_what_lies_behind_was_not() {
        let scan = |i: i64| {
            let azimuth_rad: Vec<f32> = (30..150).map(|degree| (degree as f32).to_radians()).collect();
            let range_m = azimuth_rad.iter().map(|a| 20.0 / a.sin()).collect();
            Scan { time_us: i * 100_000, range_m, azimuth_rad, ..Scan::default() }
        };
        let scans: Vec<Scan> = (0..100).map(scan).collect();
        let (contribution, _) = contribute(&scans, 1.0);
        let in_view = |x_m: f64, y_m: f64| {
            let (id, index) = TileId::locate(zone(), CellIndex::of(MapPoint::new(x_m, y_m)));
            contribution.tiles.get(&id).is_some_and(|s| s.observed.contains(view_block(index)))
        };
        let block_m = VIEW_BLOCK_CELLS as f64 * CELL_M;
        for x in (20..80).map(|x| 600_000.0 + f64::from(x)) {
            assert!(in_view(x, 3_300_012.0), "{x}");
            assert!(in_view(x, 3_300_020.0), "{x}");
            assert!(!in_view(x, 3_300_020.0 + 2.0 * block_m), "{x}");
            assert!(!in_view(x, 3_300_000.0 - 2.0 * block_m), "{x}");
        }
    }
}
