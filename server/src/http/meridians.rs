//! Intervals of longitudes on the circle that they are.

/// All meridians from one eastwards to another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meridians {
    /// The westernmost, -180 to below 180 degrees.
    pub west_deg: f64,
    /// How far it is eastwards to the last, 0 to 360 degrees.
    pub width_deg: f64,
}

impl Meridians {
    /// Eastwards from one to another, each -180 to 180 degrees. From a meridian to itself it is none, but from -180 to 180
    /// all.
    pub fn between(west_deg: f64, east_deg: f64) -> Self {
        let across = if west_deg <= east_deg { 0.0 } else { 360.0 };
        Self { west_deg: wrapped(west_deg), width_deg: east_deg + across - west_deg }
    }

    /// The narrowest interval that holds all of these; none of nothing.
    pub fn around(parts: impl IntoIterator<Item = Self>) -> Option<Self> {
        let mut parts: Vec<_> = parts.into_iter().collect();
        parts.sort_by(|a, b| a.west_deg.total_cmp(&b.west_deg));
        let first = *parts.first()?;
        // The widest gap is left out: from the easternmost end so far to where the next part begins.
        let mut end_deg =
            parts.iter().map(|part| part.west_deg + part.width_deg - 360.0).fold(f64::MIN, f64::max);
        let mut widest = (f64::MIN, first.west_deg);
        for part in &parts {
            let gap_deg = part.west_deg - end_deg;
            if gap_deg > widest.0 {
                widest = (gap_deg, part.west_deg);
            }
            end_deg = end_deg.max(part.west_deg + part.width_deg);
        }
        let (gap_deg, west_deg) = widest;
        Some(Self { west_deg, width_deg: (360.0 - gap_deg).clamp(0.0, 360.0) })
    }

    /// The easternmost, -180 to 180 degrees; smaller than the westernmost when the date line lies between.
    pub fn east_deg(self) -> f64 {
        let east_deg = self.west_deg + self.width_deg;
        if east_deg > 180.0 { east_deg - 360.0 } else { east_deg }
    }

    /// The meridian in the middle.
    pub fn middle_deg(self) -> f64 {
        wrapped(self.west_deg + 0.5 * self.width_deg)
    }

    /// Has it a meridian in common with another interval?
    pub fn meets(self, other: Self) -> bool {
        let eastwards = |from: f64, to: f64| (to - from).rem_euclid(360.0);
        eastwards(self.west_deg, other.west_deg) <= self.width_deg
            || eastwards(other.west_deg, self.west_deg) <= other.width_deg
    }
}

/// -180 to below 180 degrees.
fn wrapped(deg: f64) -> f64 {
    (deg + 180.0).rem_euclid(360.0) - 180.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points() -> impl Strategy<Value = Vec<f64>> {
        let near = (-180.0..180.0_f64, prop::collection::vec(0.0..20.0_f64, 1..8));
        near.prop_map(|(from, steps)| steps.into_iter().map(|step| wrapped(from + step)).collect())
    }

    proptest! {
        /// Catches: bounds around the whole world of a map on both sides of the date line.
        #[test]
        fn the_narrowest_interval_holds_all_and_is_no_wider(points in points()) {
            let around = Meridians::around(points.iter().map(|p| Meridians::between(*p, *p))).unwrap();
            prop_assert!(around.width_deg <= 20.0 + 1e-9, "{around:?}");
            for point in &points {
                let beyond = Meridians { west_deg: around.west_deg, width_deg: around.width_deg + 1e-9 };
                prop_assert!(beyond.meets(Meridians::between(*point, *point)), "{around:?} {point}");
            }
            let same = Meridians::between(around.west_deg, around.east_deg());
            prop_assert!((same.width_deg - around.width_deg).abs() < 1e-9, "{around:?} {same:?}");
        }

        #[test]
        fn meeting_is_mutual_and_turns_with_the_globe(
            a in (-180.0..180.0_f64, 0.0..360.0_f64), b in (-180.0..180.0_f64, 0.0..360.0_f64), turn in 0.0..360.0_f64,
        ) {
            let of = |(west, width): (f64, f64), turn: f64| Meridians { west_deg: wrapped(west + turn), width_deg: width };
            let (here, there) = (of(a, 0.0), of(b, 0.0));
            prop_assert_eq!(here.meets(there), there.meets(here));
            // Nothing of a hair's breadth.
            let apart = [(here, there), (there, here)].map(|(x, y)| ((y.west_deg - x.west_deg).rem_euclid(360.0) - x.width_deg).abs());
            prop_assume!(apart.iter().all(|gap| *gap > 1e-6));
            prop_assert_eq!(of(a, turn).meets(of(b, turn)), here.meets(there));
        }
    }

    #[test]
    fn the_whole_world_and_nothing() {
        let world = Meridians::between(-180.0, 180.0);
        assert_eq!((world.width_deg, world.east_deg()), (360.0, 180.0));
        assert!([-180.0, -179.9, 0.0, 179.9, 180.0].iter().all(|p| world.meets(Meridians::between(*p, *p))));
        assert_eq!(Meridians::around([]), None);
        assert_eq!(Meridians::around([world]), Some(world));
    }
}
