//! The town: streets, what stands along them on every day, and what is there on one day.

mod change;
mod day;
mod fronts;
mod furniture;
mod params;
mod parking;
mod streets;
mod structure;
mod traffic;
mod vehicle;

pub use change::{Change, Plot};
pub use day::CityDay;
pub(crate) use fronts::build as build_fronts;
pub(crate) use furniture::{build as build_furniture, street_frame};
pub use params::CityParams;
pub use parking::ParkingSlot;
pub(crate) use parking::slots as parking_slots;
pub(crate) use streets::Frontage;
pub use streets::{LANE_M, Network, Street};
pub(crate) use structure::Look;
pub use structure::{Reflector, ReflectorKind, Structure};
pub use traffic::{Mover, Traveller};
pub use vehicle::Car;

use std::ops::Range;

use crate::error::Error;
use crate::index::{PointRaster, SegmentIndex};
use crate::plane::Point;
use crate::site::Site;

/// A town. Positions are in city metres (see [`Site`]).
#[derive(Debug, Clone)]
pub struct City {
    params: CityParams,
    site: Site,
    network: Network,
    structure: Structure,
    slots: Vec<ParkingSlot>,
    walls: SegmentIndex,
    reflectors: PointRaster,
    passing: Vec<change::Passing>,
    /// Streets without parking, and on which days.
    narrowed: Vec<(usize, Range<u32>)>,
}

impl City {
    /// Lays a town out.
    ///
    /// # Errors
    /// When a parameter is out of range or the origin is not covered by UTM.
    pub fn generate(params: &CityParams) -> Result<Self, Error> {
        params.validate()?;
        let network = Network::generate(params);
        let mut structure = Structure::default();
        for (index, frontage) in network.frontages().into_iter().enumerate() {
            fronts::build(&mut structure, frontage, params.seed, index);
        }
        let mut slots = Vec::new();
        for (index, street) in network.streets().iter().enumerate() {
            furniture::build(&mut structure, street, params.seed, index);
            slots.extend(parking::slots(street, params.seed, index));
        }
        Self::assembled(params, network, structure, slots)
    }

    /// A town of given parts; of the parameters only those of a day count.
    pub(crate) fn assembled(
        params: &CityParams,
        network: Network,
        structure: Structure,
        slots: Vec<ParkingSlot>,
    ) -> Result<Self, Error> {
        let empty = Self {
            params: params.clone(),
            site: Site::new(params.origin)?,
            network,
            slots,
            walls: SegmentIndex::new(Vec::new()),
            reflectors: PointRaster::new(&[]),
            structure: Structure::default(),
            passing: Vec::new(),
            narrowed: Vec::new(),
        };
        Ok(empty.indexed(structure))
    }

    /// The town with this structure on every day.
    fn indexed(self, structure: Structure) -> Self {
        let positions: Vec<Point> = structure.reflectors.iter().map(|r| r.at).collect();
        Self {
            walls: SegmentIndex::new(structure.walls.clone()),
            reflectors: PointRaster::new(&positions),
            structure,
            ..self
        }
    }

    /// What the town was made from.
    #[must_use]
    pub fn params(&self) -> &CityParams {
        &self.params
    }

    /// Where the town lies on the globe.
    #[must_use]
    pub fn site(&self) -> &Site {
        &self.site
    }

    /// Intersections and streets.
    #[must_use]
    pub fn network(&self) -> &Network {
        &self.network
    }

    /// Length of all streets, metres.
    #[must_use]
    pub fn streets_m(&self) -> f64 {
        self.network.streets().iter().map(Street::length_m).sum()
    }

    /// Walls and reflectors that are there on every day: the ground truth of a map.
    #[must_use]
    pub fn structure(&self) -> &Structure {
        &self.structure
    }

    /// The slots to park in.
    #[must_use]
    pub fn slots(&self) -> &[ParkingSlot] {
        &self.slots
    }

    /// The town with the parked cars and the traffic of one day, counted from any epoch.
    #[must_use]
    pub fn on_day(&self, day: u32) -> CityDay<'_> {
        CityDay::new(self, day)
    }

    /// What of [`City::changing`] stands on a day.
    fn passing(&self, day: u32) -> impl Iterator<Item = &Structure> {
        self.passing.iter().filter(move |part| part.days.contains(&day)).map(|part| &part.structure)
    }

    pub(crate) fn walls(&self) -> &SegmentIndex {
        &self.walls
    }

    pub(crate) fn reflector_index(&self) -> &PointRaster {
        &self.reflectors
    }
}

#[cfg(test)]
mod tests;
