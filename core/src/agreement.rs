//! How well do points agree with the map? Nearest-neighbour questions to a k-d tree of the map's
//! points; the paper's map is such a tree (Sec. "Mapping").

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use crate::point::MapPoint;

/// The map's points around a position, ready for nearest-neighbour questions.
pub struct MapPointIndex {
    /// Points relative to `origin`: f32 is exact to a millimetre within some kilometres only.
    tree: Option<ImmutableKdTree<f32, 2>>,
    origin: MapPoint,
    points: usize,
}

impl MapPointIndex {
    /// Indexes points. No points make an index that nothing agrees with.
    #[must_use]
    pub fn new(points: impl IntoIterator<Item = MapPoint>) -> Self {
        let mut points = points.into_iter().peekable();
        let origin = points.peek().copied().unwrap_or_default();
        let local: Vec<[f32; 2]> = points.map(|p| relative(p, origin)).collect();
        let tree = if local.is_empty() { None } else { ImmutableKdTree::new_from_slice(&local).ok() };
        Self { tree, origin, points: local.len() }
    }

    /// Bytes held, approximately: the library does not tell what its tree takes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.points * 2 * size_of::<[f32; 2]>()
    }

    /// Distance to the nearest map point, metres; `None` without any map point.
    #[must_use]
    pub fn distance_m(&self, point: MapPoint) -> Option<f64> {
        let point = relative(point, self.origin);
        let nearest = self.tree.as_ref()?.query(&point).nearest_one::<SquaredEuclidean<f32>>().execute();
        Some(f64::from(nearest.distance).sqrt())
    }

    /// Fraction of the points that have a map point within `radius_m`; 0 without points.
    #[must_use]
    pub fn matched_fraction(&self, points: impl IntoIterator<Item = MapPoint>, radius_m: f64) -> f64 {
        let (mut matched, mut all) = (0_u32, 0_u32);
        for point in points {
            all += 1;
            matched += u32::from(self.distance_m(point).is_some_and(|d| d <= radius_m));
        }
        if all == 0 { 0.0 } else { f64::from(matched) / f64::from(all) }
    }
}

/// A position in single precision, as near a tile's points are compared.
pub(crate) fn relative(point: MapPoint, origin: MapPoint) -> [f32; 2] {
    [(point.x_m - origin.x_m) as f32, (point.y_m - origin.y_m) as f32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(n: std::ops::Range<usize>) -> impl Strategy<Value = Vec<MapPoint>> {
        let coordinate = || 0.0..100.0_f64;
        prop::collection::vec(
            (coordinate(), coordinate()).prop_map(|(x, y)| MapPoint::new(600_000.0 + x, 3_300_000.0 + y)),
            n,
        )
    }

    proptest! {
        #[test]
        fn the_nearest_is_what_a_full_search_finds(map in points(1..300), query in points(1..20)) {
            let index = MapPointIndex::new(map.iter().copied());
            for q in query {
                let best = map.iter().map(|p| p.distance_m(q)).fold(f64::INFINITY, f64::min);
                prop_assert!((index.distance_m(q).unwrap() - best).abs() < 1e-3);
            }
        }
    }

    #[test]
    fn the_fraction_counts_points_within_the_radius() {
        let index = MapPointIndex::new([1000.0, 1010.0].map(|x| MapPoint::new(x, 0.0)));
        let asked = [[1000.2, 0.0], [1005.0, 0.0], [1010.0, 0.3], [1020.0, 0.0]].map(MapPoint::from);
        assert!((index.matched_fraction(asked, 0.5) - 0.5).abs() < 1e-12);
        assert!(MapPointIndex::new([]).matched_fraction(asked, 0.5).abs() < 1e-12);
        assert!(MapPointIndex::new([]).distance_m(MapPoint::default()).is_none());
    }

    #[test]
    fn many_points_on_one_line_are_indexed_too() {
        let index = MapPointIndex::new((0..5000).map(|i| MapPoint::new(5.0, f64::from(i % 7))));
        assert!((index.distance_m(MapPoint::new(6.0, 3.0)).unwrap() - 1.0).abs() < 1e-5);
    }
}
