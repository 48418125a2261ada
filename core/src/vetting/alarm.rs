//! Uploads of several contributors are quarantined near each other, and agree: perhaps the map is wrong, or
//! the street has changed. Nothing follows by itself; an operator looks at it.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::datum::Offset;
use crate::geo::Zone;
use crate::point::MapPoint;

/// A quarantined upload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuarantinedUpload {
    /// The zone of its position.
    pub zone: Zone,
    /// Where it lies.
    pub position: MapPoint,
    /// By how much it lies beside the map; `None` when it shows something else than the map.
    pub offset: Option<Offset>,
    /// Keyed hash of its contributor's pseudonym.
    pub contributor: u64,
    /// UTC day, counted from the Unix epoch.
    pub day: u16,
}

/// When quarantined uploads make an alarm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlarmLimits {
    /// Distinct contributors, at least.
    pub contributors: usize,
    /// All of them lie within this distance of one of them, metres.
    pub within_m: f64,
    /// Their shifts differ from that one's by no more than this, metres.
    pub shift_m: f64,
    /// Their turns differ from that one's by no more than this, radians.
    pub yaw_rad: f64,
}

impl Default for AlarmLimits {
    fn default() -> Self {
        Self { contributors: 3, within_m: 100.0, shift_m: 0.3, yaw_rad: 0.5_f64.to_radians() }
    }
}

/// What quarantined uploads agree on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AlarmKind {
    /// They see the map shifted, by about this offset.
    Shift(Offset),
    /// They show something else than the map.
    Changed,
}

/// Quarantined uploads that agree with each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Alarm {
    /// The zone of its position.
    pub zone: Zone,
    /// The middle of the uploads' positions.
    pub position: MapPoint,
    /// What they agree on.
    pub kind: AlarmKind,
    /// Distinct contributors.
    pub contributors: usize,
    /// Day of the first of the uploads, counted from the Unix epoch.
    pub since: u16,
}

/// Quarantined uploads that are looked at together, each of which may be near all others.
const MOST: usize = 2000;

/// The alarms that quarantined uploads make, those of most contributors first; an upload belongs to one at most.
/// Their order does not matter. What one contributor uploads again near the same position counts once, as of the first
/// day; of very many that are left, the newest are looked at.
#[must_use]
pub fn alarms(quarantined: &[QuarantinedUpload], limits: &AlarmLimits) -> Vec<Alarm> {
    let distinct = distinct(quarantined, limits);
    let zones: BTreeSet<Zone> = distinct.iter().map(|q| q.zone).collect();
    let mut alarms = Vec::new();
    for zone in zones {
        let mut here: Vec<&QuarantinedUpload> = distinct.iter().filter(|q| q.zone == zone).copied().collect();
        here.sort_by_key(|q| (bits(q.position), q.contributor, q.day, q.offset));
        alarms.extend(in_zone(&here, limits));
    }
    alarms.sort_by_key(|alarm| Reverse(alarm.contributors));
    alarms
}

/// Something to order positions by.
fn bits(position: MapPoint) -> [u64; 2] {
    [position.x_m.to_bits(), position.y_m.to_bits()]
}

/// The first upload of each contributor near each position.
fn distinct<'a>(quarantined: &'a [QuarantinedUpload], limits: &AlarmLimits) -> Vec<&'a QuarantinedUpload> {
    let mut all: Vec<&QuarantinedUpload> = quarantined.iter().collect();
    all.sort_by_key(|q| (q.day, bits(q.position), q.contributor, q.offset));
    let step = |value: f64, size: f64| (value / size).round() as i64;
    let mut said = BTreeSet::new();
    all.retain(|q| {
        let position = [q.position.x_m, q.position.y_m].map(|along| step(along, 0.5 * limits.within_m));
        let offset = q.offset.map(|offset| {
            let pose = offset.pose();
            let shift = [pose.x_m, pose.y_m].map(|along| step(along, 0.5 * limits.shift_m));
            (shift, step(pose.yaw_rad, 0.5 * limits.yaw_rad))
        });
        said.insert((q.zone, q.contributor, position, offset))
    });
    all.split_off(all.len().saturating_sub(MOST))
}

fn in_zone(here: &[&QuarantinedUpload], limits: &AlarmLimits) -> Vec<Alarm> {
    let positions: Vec<[f64; 2]> = here.iter().map(|q| q.position.into()).collect();
    // A tree is refused for more positions than it can number.
    let Ok(tree) = ImmutableKdTree::<f64, 2>::new_from_slice(&positions) else { return Vec::new() };
    let within = limits.within_m * limits.within_m;
    let around = |seed: &&QuarantinedUpload| {
        let near = tree.query(&seed.position.into()).within::<SquaredEuclidean<f64>>(within).execute();
        let mut group: Vec<usize> = near.into_iter().map(|n| n.item as usize).collect();
        group.retain(|other| alike(seed, here[*other], limits));
        group.sort_unstable();
        group
    };
    let mut groups: Vec<Vec<usize>> = here.iter().map(around).collect();
    groups.sort_by_cached_key(|group| Reverse(contributors(here, group)));
    let mut taken = vec![false; here.len()];
    let mut alarms = Vec::new();
    for mut group in groups {
        group.retain(|member| !taken[*member]);
        if contributors(here, &group) < limits.contributors.max(1) {
            continue;
        }
        for member in &group {
            taken[*member] = true;
        }
        alarms.extend(alarm(here, &group));
    }
    alarms
}

/// True when two uploads, near each other, may be quarantined for the same reason.
fn alike(a: &QuarantinedUpload, b: &QuarantinedUpload, limits: &AlarmLimits) -> bool {
    match (a.offset, b.offset) {
        (None, None) => true,
        (Some(a), Some(b)) => {
            let (a, b) = (a.pose(), b.pose());
            a.distance_m(&b) <= limits.shift_m && (a.yaw_rad - b.yaw_rad).abs() <= limits.yaw_rad
        }
        _ => false,
    }
}

fn contributors(here: &[&QuarantinedUpload], group: &[usize]) -> usize {
    group.iter().map(|member| here[*member].contributor).collect::<BTreeSet<_>>().len()
}

fn alarm(here: &[&QuarantinedUpload], group: &[usize]) -> Option<Alarm> {
    let members = || group.iter().map(|member| here[*member]);
    let count = group.len() as f64;
    let middle = |along: fn(MapPoint) -> f64| members().map(|q| along(q.position)).sum::<f64>() / count;
    let position = MapPoint::new(middle(|p| p.x_m), middle(|p| p.y_m));
    let offsets: Vec<Offset> = members().filter_map(|q| q.offset).collect();
    let mean = |part: fn(&Offset) -> i32| {
        let sum: i64 = offsets.iter().map(|o| i64::from(part(o))).sum();
        (sum / (offsets.len() as i64).max(1)) as i32
    };
    let kind = if offsets.is_empty() {
        AlarmKind::Changed
    } else {
        AlarmKind::Shift(Offset {
            east_mm: mean(|o| o.east_mm),
            north_mm: mean(|o| o.north_mm),
            yaw_urad: mean(|o| o.yaw_urad),
        })
    };
    let first = members().next()?;
    let since = members().map(|q| q.day).min().unwrap_or(first.day);
    Some(Alarm { zone: first.zone, position, kind, contributors: contributors(here, group), since })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn upload(x: f64, offset_mm: Option<[i32; 2]>, contributor: u64, day: u16) -> QuarantinedUpload {
        let offset = offset_mm.map(|[east_mm, north_mm]| Offset { east_mm, north_mm, yaw_urad: 0 });
        let zone = Zone::from_epsg(32614).expect("a zone");
        let position = MapPoint::new(600_000.0 + x, 3_300_000.0);
        QuarantinedUpload { zone, position, offset, contributor, day }
    }

    fn found(quarantined: &[QuarantinedUpload]) -> Vec<Alarm> {
        alarms(quarantined, &AlarmLimits::default())
    }

    #[test]
    fn three_who_agree_make_an_alarm() {
        let three = [
            upload(0.0, Some([1000, 100]), 1, 20_003),
            upload(60.0, Some([1100, 0]), 2, 20_001),
            upload(30.0, Some([900, -100]), 3, 20_002),
        ];
        let [alarm] = found(&three)[..] else { panic!("one alarm: {:?}", found(&three)) };
        assert_eq!((alarm.contributors, alarm.since), (3, 20_001));
        assert_eq!(alarm.kind, AlarmKind::Shift(Offset { east_mm: 1000, north_mm: 0, yaw_urad: 0 }));
        assert!((alarm.position.x_m - 600_030.0).abs() < 1e-9);
        let reversed: Vec<_> = three.iter().rev().copied().collect();
        assert_eq!(found(&reversed), [alarm]);
    }

    /// Catches: uploads counted instead of contributors, and offsets, distances or zones that are not compared.
    #[test]
    fn one_contributor_or_three_who_differ_make_none() {
        let of_one: Vec<_> = (0..9).map(|day| upload(0.0, Some([1000, 0]), 1, day)).collect();
        assert!(found(&of_one).is_empty());
        let differ = [[1000, 0], [-1000, 0], [0, 1000]];
        let differ: Vec<_> = (0..3).map(|i| upload(0.0, Some(differ[i]), i as u64, 1)).collect();
        assert!(found(&differ).is_empty());
        let far: Vec<_> = (0..3).map(|i| upload(150.0 * i as f64, None, i, 1)).collect();
        assert!(found(&far).is_empty());
        let mut turned: Vec<_> = (0..3).map(|i| upload(0.0, Some([0, 0]), i, 1)).collect();
        assert_eq!(found(&turned).len(), 1);
        turned[2].offset = Some(Offset { yaw_urad: 30_000, ..Offset::default() });
        assert!(found(&turned).is_empty());
        let mut zones: Vec<_> = (0..3).map(|i| upload(0.0, None, i, 1)).collect();
        assert_eq!(found(&zones).len(), 1);
        zones[0].zone = Zone::from_epsg(32615).expect("a zone");
        assert!(found(&zones).is_empty());
    }

    /// Catches: uploads that show something else grouped with ones that are shifted, and groups that overlap.
    #[test]
    fn two_causes_are_two_alarms_and_the_larger_comes_first() {
        let shifted = (0..3).map(|i| upload(10.0 * i as f64, Some([2000, 0]), i, 5));
        let changed = (0..4).map(|i| upload(10.0 * i as f64, None, 10 + i, 4));
        let both: Vec<_> = shifted.chain(changed).collect();
        let alarms = found(&both);
        assert_eq!(alarms.iter().map(|a| a.contributors).collect::<Vec<_>>(), [4, 3]);
        assert_eq!((alarms[0].kind, alarms[0].since), (AlarmKind::Changed, 4));
        assert!(found(&[]).is_empty());
    }

    /// Catches: a page that takes minutes and gigabytes once a building site was passed by for months.
    #[test]
    fn what_is_said_again_counts_once_and_of_very_many_the_newest() {
        let again: Vec<_> = (0..30).map(|day| upload(f64::from(day % 3), None, 1, 100 + day)).collect();
        let limits = AlarmLimits::default();
        assert_eq!(distinct(&again, &limits).iter().map(|q| q.day).collect::<Vec<_>>(), [100]);
        let many: Vec<_> = (0..3000).map(|i| upload(0.0, None, i, i as u16)).collect();
        let kept = distinct(&many, &limits);
        assert_eq!((kept.len(), kept[0].day), (MOST, 1000));
        assert_eq!(found(&many).iter().map(|a| a.contributors).collect::<Vec<_>>(), [MOST]);
    }

    /// The tree must take many uploads of one position: a spammer's, say.
    #[test]
    fn many_uploads_of_one_place_are_indexed() {
        let many: Vec<_> = (0..3000).map(|i| upload(0.0, None, i % 5, 1)).collect();
        assert_eq!(found(&many).iter().map(|a| a.contributors).collect::<Vec<_>>(), [5]);
    }
}
