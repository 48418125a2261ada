//! The town on one day.

use std::ops::ControlFlow;

use super::{Car, City, Mover, Reflector, Traveller, parking, traffic};
use crate::index::{PointRaster, SegmentIndex};
use crate::plane::Point;

/// How much of a tall reflector's signal passes one diagonal of a parked car: radar sees through
/// windows, under the floor and over the bonnet.
const THROUGH_A_CAR: f64 = 0.6;

/// The town with the parked cars and the traffic of one day.
#[derive(Debug, Clone)]
pub struct CityDay<'a> {
    city: &'a City,
    day: u32,
    parked: Vec<Car>,
    travellers: Vec<Traveller>,
    /// Of cars, and of what stands there on some days only.
    reflectors: Vec<Reflector>,
    reflector_index: PointRaster,
    /// What stands there on some days only.
    walls: SegmentIndex,
    diagonals: SegmentIndex,
}

impl<'a> CityDay<'a> {
    pub(super) fn new(city: &'a City, day: u32) -> Self {
        let parked = parking::parked(city.slots(), city.params(), day, |slot| city.may_park(slot, day));
        let of_cars = parked.iter().flat_map(Car::reflectors);
        let passing = city.passing(day).flat_map(|part| part.reflectors.iter().copied());
        let reflectors: Vec<_> = of_cars.chain(passing).collect();
        let positions: Vec<Point> = reflectors.iter().map(|r| r.at).collect();
        Self {
            city,
            day,
            travellers: traffic::travellers(city.network(), city.params(), day),
            reflector_index: PointRaster::new(&positions),
            walls: SegmentIndex::new(city.passing(day).flat_map(|part| part.walls.iter().copied()).collect()),
            diagonals: SegmentIndex::new(parked.iter().flat_map(Car::diagonals).collect()),
            reflectors,
            parked,
        }
    }

    /// The town.
    #[must_use]
    pub fn city(&self) -> &'a City {
        self.city
    }

    /// The day's number.
    #[must_use]
    pub fn day(&self) -> u32 {
        self.day
    }

    /// The cars that stand in the slots today.
    #[must_use]
    pub fn parked(&self) -> &[Car] {
        &self.parked
    }

    /// The vehicles on the move at a time.
    pub fn movers(&self, time_us: i64) -> impl Iterator<Item = Mover> + '_ {
        self.travellers.iter().map(move |t| t.at(time_us))
    }

    /// Calls `visit` for a superset of the stationary reflectors within `radius_m` of `centre`, in
    /// buckets `may_hold` accepts (see [`PointRaster::visit`]), always in the same order.
    pub(crate) fn visit(
        &self,
        centre: Point,
        radius_m: f64,
        may_hold: impl Fn(Point, f64) -> bool,
        mut visit: impl FnMut(&Reflector),
    ) {
        let fixed = &self.city.structure().reflectors;
        self.city.reflector_index().visit(centre, radius_m, &may_hold, |item| visit(&fixed[item]));
        self.reflector_index.visit(centre, radius_m, &may_hold, |item| visit(&self.reflectors[item]));
    }

    /// The fraction of a reflector's signal that walls and parked cars let pass on its way to a point.
    #[must_use]
    pub fn transmission(&self, from: Point, reflector: &Reflector) -> f64 {
        if self.city.walls().blocks(from, reflector.at) || self.walls.blocks(from, reflector.at) {
            return 0.0;
        }
        let mut fraction = 1.0;
        self.diagonals.visit(from, reflector.at, |_| {
            fraction *= if reflector.is_low() { 0.0 } else { THROUGH_A_CAR };
            if fraction < 0.05 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
        fraction
    }
}
