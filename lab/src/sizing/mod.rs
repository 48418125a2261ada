//! `echofix sizing`: what a fleet of vehicles asks of several replicas over one bucket, simulated from measured costs.
//!
//! A fluid model: rates stand still within a minute, queues of milliseconds are in their steady state, and everything is
//! reckoned for a whole day. Real are the routing regions and their rendezvous hashing (`core/src/geo/routing.rs`), what is
//! wanted and whose turn it is (`core/src/demand.rs`), and the balancer's hash, which is held to the program's own.
//!
//! - [`command`]: the arguments.
//! - [`costs`]: what one of each thing costs, as it was measured.
//! - [`country`] and [`day`]: where and when vehicles drive; assumed.
//! - [`balancer`]: which replica a region's calls go to. [`shares`]: what each replica has of roads and vehicles.
//! - [`cache`], [`queue`] and [`latency`]: what a fix waits for.
//! - [`wanted`], [`uploads`] and [`bucket`]: which uploads are made, and their way into the map.
//! - [`simulation`]: a day, and what goes wrong on it.
//! - [`mod@page`]: the figures as a page.

mod balancer;
mod bucket;
mod cache;
pub mod command;
mod costs;
mod country;
mod day;
mod latency;
mod page;
mod queue;
mod shares;
mod simulation;
mod uploads;
mod wanted;

use std::collections::BTreeMap;

use echofix_core::demand::DemandPolicy;
use serde::Serialize;

use balancer::Ring;
use costs::Costs;
use country::Region;
use day::{MINUTES, mean_share};
use shares::{Places, Scale};
use simulation::{Blow, Outcome, Simulation};
use wanted::{Told, Wanted};

/// Minutes of driving that one upload holds.
const UPLOAD_MINUTES: f64 = 1.0;

/// How large everything is.
#[derive(Debug, Clone, Serialize)]
struct Plan {
    pub seed: u64,
    /// On the road at once in the busiest minute; each asks once a second.
    pub vehicles: f64,
    pub road_km: f64,
    pub speed_kmh: f64,
    pub replicas: usize,
    /// Of each replica.
    pub cores: u32,
    /// Memory for prepared tiles, of each replica.
    pub cache_gib: f64,
    /// Of each server in the balancer.
    pub weight: u32,
    /// No replica gets more than so many times the mean.
    pub factor: Option<f64>,
    pub told: Told,
    /// Places of each kind whose uploads are simulated.
    pub places: u32,
}

impl Plan {
    fn scale(&self, regions: &[Region], places: &Places) -> Scale {
        let mut on_road = vec![0.0; MINUTES];
        for region in regions {
            let shares = &places.shares[places.of_region(region)];
            for (sum, share) in on_road.iter_mut().zip(shares) {
                *sum += region.vehicle_share * share;
            }
        }
        let busiest = on_road.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let km_per_s = self.speed_kmh / 3600.0;
        Scale { vehicles: self.vehicles / busiest, road_km: self.road_km, km_per_s }
    }

    /// Kilometres of road that one upload holds.
    fn upload_km(&self) -> f64 {
        self.speed_kmh / 60.0 * UPLOAD_MINUTES
    }
}

/// Uploads of the whole map, for one way to tell what is wanted.
#[derive(Debug, Clone, Copy, Serialize)]
struct Demanded {
    told: Told,
    /// A day, once the map is known.
    a_day: f64,
    /// Until it is.
    at_first: f64,
}

/// By how much the replica with the most has more than the mean: of vehicles in the busiest minute, and of regions.
#[derive(Debug, Clone, Serialize)]
struct Balance {
    name: String,
    vehicles: f64,
    regions: f64,
}

/// All figures.
#[derive(Debug, Clone, Serialize)]
struct Figures {
    plan: Plan,
    costs: Costs,
    regions: usize,
    demanded: Vec<Demanded>,
    balances: Vec<Balance>,
    days: Vec<Outcome>,
    /// The hot city without the balancer's bound.
    unbounded: Outcome,
}

fn run(plan: Plan, costs: Costs, say: &impl Fn(&str)) -> Figures {
    say("A continent is made up.");
    let regions = country::regions(plan.seed, country::CONTINENT);
    let places = Places::of(&regions);
    say(&format!("{} routing regions. What is wanted of their roads.", regions.len()));
    let told = [Told::Nothing, Told::Uploads, Told::Coverage];
    let demanded = told.map(|told| demanded(&plan, told, &regions, &places)).to_vec();
    let uploads =
        demanded.iter().find(|demanded| demanded.told == plan.told).map_or(0.0, |found| found.a_day);
    say("Days of the replicas.");
    let on = |plan: &Plan, blow: Blow| Simulation::new(plan, &costs, (&regions, &places), uploads).day(blow);
    let blows = [Blow::Nothing, Blow::ReplicaLost, Blow::BucketAway, Blow::HotCity];
    let days = blows.map(|blow| on(&plan, blow)).to_vec();
    let unbounded = on(&Plan { factor: None, ..plan.clone() }, Blow::HotCity);
    let balances = balances(&plan, &regions, &places);
    Figures { regions: regions.len(), plan, costs, demanded, balances, days, unbounded }
}

/// Uploads of all roads: those of places with as many passes a day, times how many such places there are.
fn demanded(plan: &Plan, told: Told, regions: &[Region], places: &Places) -> Demanded {
    let scale = plan.scale(regions, places);
    let km_a_day = scale.vehicles * scale.km_per_s * 86_400.0 * mean_share();
    let mut kinds: BTreeMap<i32, [f64; 2]> = BTreeMap::new();
    for region in regions {
        let passes = km_a_day * region.vehicle_share / (plan.road_km * region.road_share);
        let kind = kinds.entry((passes.log2() * 2.0).round() as i32).or_default();
        kind[0] += region.road_share;
        kind[1] += region.vehicle_share;
    }
    let mut sum = Wanted::default();
    for [roads, vehicles] in kinds.into_values() {
        let passes = km_a_day * vehicles / (plan.road_km * roads);
        let of_place = wanted::of_place(told, DemandPolicy::default(), passes, plan.places, plan.seed);
        let count = plan.road_km * roads / plan.upload_km();
        sum.a_day += count * of_place.a_day;
        sum.at_first += count * of_place.at_first;
    }
    Demanded { told, a_day: sum.a_day, at_first: sum.at_first }
}

fn balances(plan: &Plan, regions: &[Region], places: &Places) -> Vec<Balance> {
    let scale = plan.scale(regions, places);
    let busiest = (0..MINUTES)
        .max_by(|a, b| {
            let at = |minute: &usize| places.shares.iter().map(|shares| shares[*minute]).sum::<f64>();
            at(a).total_cmp(&at(b))
        })
        .unwrap_or_default();
    let over_mean = |loads: Vec<f64>| {
        loads.iter().copied().fold(0.0, f64::max) * loads.len() as f64 / loads.iter().sum::<f64>()
    };
    let balance = |name: String, owner: &dyn Fn(&Region) -> usize| {
        let parts =
            shares::parts(regions, places, plan.replicas, scale, |region| (owner(region), shares::ALWAYS));
        let loads = parts.iter().map(|part| part.on_the_road(places, busiest, 1.0)).collect();
        let mut counts = vec![0.0; plan.replicas];
        for region in regions {
            counts[owner(region)] += 1.0;
        }
        Balance { name, vehicles: over_mean(loads), regions: over_mean(counts) }
    };
    let mut balances = Vec::new();
    for weight in [1, 16, 100, 256] {
        let ring = Ring::new(plan.replicas, weight, None);
        let name = format!("HAProxy, servers of weight {weight}");
        balances.push(balance(name, &|region| ring.server(region.id)));
    }
    let names: Vec<_> =
        (0..plan.replicas).map(|replica| format!("https://replica-{replica}:50051")).collect();
    let name = "rendezvous hashing (`x-echofix-better-asked-at`)".to_owned();
    balances.push(balance(name, &|region| region.id.best_of(&names).unwrap_or(0)));
    balances
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAND: [f64; 4] = [44.0, 49.0, 5.0, 15.0];

    fn plan() -> Plan {
        Plan {
            seed: 1,
            vehicles: 200_000.0,
            road_km: 1e6,
            speed_kmh: 36.0,
            replicas: 6,
            cores: 96,
            cache_gib: 200.0,
            weight: 100,
            factor: Some(1.5),
            told: Told::Coverage,
            places: 2,
        }
    }

    /// Catches: calls and uploads that are lost or made on the way through a day, whatever goes wrong; a blow that does
    /// nothing, or goes on after it is over.
    #[test]
    fn everything_that_is_asked_comes_to_something() {
        let costs = Costs::read(None).unwrap();
        let regions = country::regions(1, LAND);
        let places = Places::of(&regions);
        let plan = plan();
        let uploads = 2e6;
        let simulation = Simulation::new(&plan, &costs, (&regions, &places), uploads);
        let usual = simulation.day(Blow::Nothing);
        for blow in [Blow::Nothing, Blow::ReplicaLost, Blow::BucketAway, Blow::HotCity] {
            let day = simulation.day(blow);
            let somewhere = day.answered + day.refused + day.unanswered;
            assert!((somewhere / day.asked - 1.0).abs() < 1e-9, "{day:?}");
            assert!((day.uploads.made / uploads - 1.0).abs() < 1e-9, "{day:?}");
            assert!(day.uploads.lost().abs() < 1e-6 * uploads, "{day:?}");
            assert!(blow == Blow::Nothing || day.worst_p99_ms >= usual.worst_p99_ms, "{day:?}");
            assert_eq!(day, simulation.day(blow), "the same again");
        }
        // Each vehicle once a second, all of them in the busiest minute.
        let mean = usual.asked / 86_400.0 / plan.vehicles;
        assert!((0.4..0.7).contains(&mean), "{mean}");
        let lost = simulation.day(Blow::ReplicaLost);
        assert!(lost.unanswered > 0.0 && lost.cold_km_s > 1.5 * usual.cold_km_s, "{lost:?}\n{usual:?}");
        let away = simulation.day(Blow::BucketAway);
        assert!(away.uploads.most_spooled > usual.uploads.most_spooled && away.spools_empty_after >= 1);
        assert!((away.answered - usual.answered).abs() < 1e-6 * usual.answered, "fixes go on");
    }

    /// Catches: replicas that refuse nothing although they cannot.
    #[test]
    fn too_few_cores_refuse_what_they_cannot_answer() {
        let costs = Costs::read(None).unwrap();
        let regions = country::regions(1, LAND);
        let places = Places::of(&regions);
        let plan = Plan { cores: 40, factor: None, ..plan() };
        let day = Simulation::new(&plan, &costs, (&regions, &places), 0.0).day(Blow::Nothing);
        let most = f64::from(plan.cores) * plan.replicas as f64;
        assert!(day.refused > 0.01 * day.asked && day.peak_cores <= most + 1e-6, "{day:?}");
        assert!((day.answered + day.refused - day.asked).abs() < 1e-6 * day.asked);
    }
}
