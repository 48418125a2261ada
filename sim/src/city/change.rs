//! What changes in the town from one day to another, besides cars.

use std::f64::consts::PI;
use std::ops::Range;

use echofix_core::pose::Pose2;

use super::furniture::street_frame;
use super::streets::Street;
use super::structure::{Look, ReflectorKind, Structure};
use super::{City, ParkingSlot, fronts};
use crate::error::{Error, within};
use crate::plane::Point;

/// Buildings reach so far beyond the line of fronts, metres: bays stand out, walls are modelled so deep.
const PLOT_M: Range<f64> = -0.5..14.0;
/// Barriers stand before the rows of parked cars, so far from the kerb, metres.
const BARRIER_M: f64 = 2.7;
/// From post to post of a barrier, metres.
const POSTS_M: f64 = 1.5;
/// Length and width of a site's containers, metres: those that ships carry.
const CONTAINER_M: [f64; 2] = [6.1, 2.4];
/// From one container to the next, metres.
const GAP_M: f64 = 1.9;

/// A stretch of one side of a street, where buildings stand.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// The street's number.
    pub street: usize,
    /// On its left, seen from its first node?
    pub left: bool,
    /// From and to, metres along the street.
    pub along_m: Range<f64>,
}

/// Something that is not the same on every day.
#[derive(Debug, Clone, PartialEq)]
pub enum Change {
    /// What stands on a plot is gone from a day on; a fenced lot is left.
    Demolished(Plot, u32),
    /// What stands on a plot is built on a day; before, there is a fenced lot.
    Built(Plot, u32),
    /// A street is a building site on some days: containers stand along both its kerbs where else cars park, and
    /// hide the fronts behind them; barriers before them leave the lanes free.
    Roadworks(usize, Range<u32>),
}

impl Change {
    fn street(&self) -> usize {
        match self {
            Self::Demolished(plot, _) | Self::Built(plot, _) => plot.street,
            Self::Roadworks(street, _) => *street,
        }
    }
}

/// What stands in the town on some days only.
#[derive(Debug, Clone)]
pub(super) struct Passing {
    /// On which days.
    pub days: Range<u32>,
    pub structure: Structure,
}

impl City {
    /// The same town with changes.
    ///
    /// # Errors
    /// When a change names a street that the town does not have.
    pub fn changing(mut self, changes: &[Change]) -> Result<Self, Error> {
        let last = self.network.streets().len() as f64 - 1.0;
        for change in changes {
            within("street", change.street() as f64, (0.0, last), "one of the town's streets")?;
        }
        let mut structure = std::mem::take(&mut self.structure);
        for change in changes {
            match change {
                Change::Demolished(plot, day) => {
                    let (gone, lot) = self.replaced(&mut structure, plot);
                    self.passing.push(Passing { days: 0..*day, structure: gone });
                    self.passing.push(Passing { days: *day..u32::MAX, structure: lot });
                }
                Change::Built(plot, day) => {
                    let (built, lot) = self.replaced(&mut structure, plot);
                    self.passing.push(Passing { days: 0..*day, structure: lot });
                    self.passing.push(Passing { days: *day..u32::MAX, structure: built });
                }
                Change::Roadworks(street, days) => {
                    let structure = site(&self.network.streets()[*street]);
                    self.passing.push(Passing { days: days.clone(), structure });
                    self.narrowed.push((*street, days.clone()));
                }
            }
        }
        Ok(self.indexed(structure))
    }

    /// Takes out what stands on a plot: that, and the lot in its place.
    fn replaced(&self, structure: &mut Structure, plot: &Plot) -> (Structure, Structure) {
        let street = &self.network.streets()[plot.street];
        let frame = plot.frame(street);
        let to_plot = frame.inverse();
        let inside = |at: Point| {
            let [x, y] = to_plot.transform(at);
            plot.along(street).contains(&x) && PLOT_M.contains(&y)
        };
        let middle = |a: Point, b: Point| [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        let gone = Structure {
            walls: structure.walls.extract_if(.., |wall| inside(middle(wall.a, wall.b))).collect(),
            reflectors: structure
                .reflectors
                .extract_if(.., |r| {
                    matches!(r.kind, ReflectorKind::Wall | ReflectorKind::Corner | ReflectorKind::Fence)
                        && inside(r.at)
                })
                .collect(),
        };
        let mut lot = Structure::default();
        let Range { start, end } = plot.along(street);
        fronts::fenced_lot(&mut lot, frame, (start, end), self.params.seed, plot.street);
        (gone, lot)
    }

    /// Is a slot usable on a day?
    pub(super) fn may_park(&self, slot: &ParkingSlot, day: u32) -> bool {
        let closed = |street: &Street| {
            let [x, y] = street_frame(street).inverse().transform([slot.pose.x_m, slot.pose.y_m]);
            (0.0..street.length_m()).contains(&x) && y.abs() < street.kerb_m
        };
        let narrowed = self.narrowed.iter().filter(|(_, days)| days.contains(&day));
        !narrowed.into_iter().any(|(street, _)| closed(&self.network.streets()[*street]))
    }
}

impl Plot {
    /// The frame of the line of fronts: x along it with the block on the left, y into the block.
    fn frame(&self, street: &Street) -> Pose2 {
        let on_street = if self.left {
            Pose2::new(0.0, street.front_m, 0.0)
        } else {
            Pose2::new(street.length_m(), -street.front_m, PI)
        };
        street_frame(street).compose(&on_street)
    }

    /// The stretch along that line.
    fn along(&self, street: &Street) -> Range<f64> {
        let Range { start, end } = self.along_m;
        if self.left { start..end } else { street.length_m() - end..street.length_m() - start }
    }
}

/// Containers and barriers along both sides of a street.
fn site(street: &Street) -> Structure {
    let clear = super::furniture::CLEAR_M;
    let frame = street_frame(street);
    let free_m = street.length_m() - 2.0 * clear;
    let [length_m, width_m] = CONTAINER_M;
    let mut structure = barriers(street);
    for k in 0..(free_m / (length_m + GAP_M)).max(0.0) as usize {
        let x = clear + (k as f64 + 0.5) * (length_m + GAP_M);
        for (sign, yaw_rad) in [(1.0, PI), (-1.0, 0.0)] {
            let y = sign * (street.kerb_m - 0.5 * width_m);
            container(&mut structure, &frame.compose(&Pose2::new(x, y, yaw_rad)));
        }
    }
    structure
}

/// A container about a pose whose left is the lanes' side: corners, a corrugated side, and what it hides.
fn container(structure: &mut Structure, at: &Pose2) {
    let [l, w] = CONTAINER_M.map(|side| 0.5 * side);
    let corner = Look { kind: ReflectorKind::Corner, probability: 0.35, rcs_dbsm: 8.0, edge_rad: 1.3 };
    let side = Look { kind: ReflectorKind::Wall, probability: 0.15, rcs_dbsm: 4.0, edge_rad: 0.9 };
    let corners = [([l, w], 0.25 * PI), ([-l, w], 0.75 * PI), ([l, -w], -0.25 * PI), ([-l, -w], -0.75 * PI)];
    structure.reflectors.extend(corners.map(|(position, facing)| corner.at(at, position, facing)));
    let ribs = (-2..=2).map(|k| side.at(at, [f64::from(k), w], 0.5 * PI));
    structure.reflectors.extend(ribs);
    structure.wall(at, &[[-l + 0.2, 0.0], [l - 0.2, 0.0]]);
}

/// Barriers along both sides of a street.
fn barriers(street: &Street) -> Structure {
    let post = Look { kind: ReflectorKind::Fence, probability: 0.25, rcs_dbsm: 2.0, edge_rad: 4.0 };
    let clear = super::furniture::CLEAR_M;
    let (frame, y) = (street_frame(street), street.kerb_m - BARRIER_M);
    let count = ((street.length_m() - 2.0 * clear) / POSTS_M).max(0.0) as usize;
    let posts = (0..count).flat_map(|k| [-y, y].map(|y| [clear + k as f64 * POSTS_M, y]));
    let reflectors = posts.map(|position| post.at(&frame, position, 0.0)).collect();
    Structure { walls: Vec::new(), reflectors }
}

#[cfg(test)]
mod tests {
    use super::super::CityParams;
    use super::*;

    fn plot() -> Plot {
        Plot { street: 0, left: true, along_m: 40.0..70.0 }
    }

    fn town(changes: &[Change]) -> City {
        City::generate(&CityParams::default()).unwrap().changing(changes).unwrap()
    }

    /// Sorted positions of what stands still on a day.
    fn fixed(city: &City, day: u32) -> Vec<[i64; 2]> {
        let day = city.on_day(day);
        let mut all = Vec::new();
        let mut add = |r: &super::super::Reflector| {
            if r.kind != ReflectorKind::Vehicle {
                all.push(r.at.map(|c| (c * 1e6).round() as i64));
            }
        };
        day.visit([0.0, 0.0], 1e4, |_, _| true, &mut add);
        all.sort_unstable();
        all
    }

    /// Catches: a change on the wrong side of its day, and one that takes more than its plot.
    #[test]
    fn what_is_gone_was_there_before_and_what_is_built_is_there_after() {
        let plain = fixed(&town(&[]), 0);
        let demolished = town(&[Change::Demolished(plot(), 10)]);
        let built = town(&[Change::Built(plot(), 10)]);
        assert_eq!(fixed(&demolished, 9), plain);
        assert_eq!(fixed(&built, 10), plain);
        assert_eq!(fixed(&built, 9), fixed(&demolished, 10));
        let left = fixed(&demolished, 10);
        let gone = plain.iter().filter(|at| left.binary_search(at).is_err()).count();
        assert!((50..plain.len() / 10).contains(&gone), "{gone} of {}", plain.len());
    }

    #[test]
    fn changes_are_in_streets_of_the_town() {
        let city = City::generate(&CityParams::default()).unwrap();
        assert!(city.changing(&[Change::Roadworks(99, 0..1)]).is_err());
    }

    /// Catches: containers on other days, outside the rows of parked cars, and cars parked through them.
    #[test]
    fn containers_stand_where_cars_park_while_there_are_roadworks() {
        let (plain, closed) = (town(&[]), town(&[Change::Roadworks(1, 5..8)]));
        for day in [4, 8] {
            assert_eq!(fixed(&closed, day), fixed(&plain, day));
            assert_eq!(closed.on_day(day).parked(), plain.on_day(day).parked());
        }
        assert!(fixed(&closed, 5).len() > fixed(&plain, 5).len() + 100);
        let street = &plain.network.streets()[1];
        let (to_street, site) = (street_frame(street).inverse(), site(street));
        for at in site.reflectors.iter().map(|r| r.at).chain(site.walls.iter().flat_map(|w| [w.a, w.b])) {
            let [x, y] = to_street.transform(at);
            assert!((0.0..street.length_m()).contains(&x), "{x}");
            assert!((street.kerb_m - BARRIER_M - 1e-6..=street.kerb_m + 1e-6).contains(&y.abs()), "{y}");
        }
        assert!(closed.on_day(5).parked().len() + 5 < plain.on_day(5).parked().len());
    }
}
