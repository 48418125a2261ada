//! A day, minute by minute. Within a minute rates stand still: queues of milliseconds are in their steady state.

use serde::Serialize;

use super::Plan;
use super::balancer::{Ring, bounded};
use super::bucket::{Traffic, appending};
use super::cache::{Streets, back};
use super::costs::Costs;
use super::country::Region;
use super::day::MINUTES;
use super::latency::Latencies;
use super::queue::Queue;
use super::shares::{ALWAYS, Part, Places, Scale, parts};
use super::uploads::Uploads;

/// What goes wrong, in the busiest minute.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub(super) enum Blow {
    Nothing,
    /// A replica is gone for an hour; the one that comes in its place has prepared no tiles.
    ReplicaLost,
    /// The bucket does not answer for a minute.
    BucketAway,
    /// Three times as many vehicles in the largest city, for two hours.
    HotCity,
}

/// Seconds until the balancer knows that a replica is gone (docker/haproxy.cfg: every 2 s, two in a row).
const UNKNOWN_S: f64 = 4.0;
const GONE_MINUTES: usize = 60;
const HOT_MINUTES: usize = 120;
const HOT: f64 = 3.0;
/// The cache's reach changes slowly.
const REACH_EVERY: usize = 10;
/// Questions that may wait in a replica (`locating.queue`).
const PLACES: u32 = 64;

/// What came of the day.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Outcome {
    pub blow: Blow,
    pub asked: f64,
    pub answered: f64,
    pub refused: f64,
    /// Asked of a replica that was gone, before the balancer knew.
    pub unanswered: f64,
    pub p50_ms: f64,
    pub p99_ms: f64,
    /// The largest p99 of a minute, and the largest share without an answer.
    pub worst_p99_ms: f64,
    pub worst_share: f64,
    /// Busy cores, on the mean and in the busiest minute.
    pub mean_cores: f64,
    pub peak_cores: f64,
    /// Of its cores, what fixes take in the busiest minute of the busiest replica.
    pub busiest: f64,
    /// Kilometres that are prepared in the busiest minute, a second, all replicas.
    pub cold_km_s: f64,
    pub uploads: Uploads,
    /// Minutes from the blow until no more uploads wait in spools than before; 0 where none did.
    pub spools_empty_after: usize,
    pub acknowledged_ms: f64,
    pub traffic: Traffic,
}

/// One fleet of replicas.
pub(super) struct Simulation<'a> {
    plan: &'a Plan,
    costs: &'a Costs,
    places: &'a Places,
    /// Uploads a day.
    uploads: f64,
    scale: Scale,
    usual: Vec<Part>,
    /// The busiest minute.
    busiest: usize,
    /// Of a day's driving, what lies in each minute.
    on_road: Vec<f64>,
    regions: &'a [Region],
}

impl<'a> Simulation<'a> {
    pub fn new(
        plan: &'a Plan,
        costs: &'a Costs,
        (regions, places): (&'a [Region], &'a Places),
        uploads: f64,
    ) -> Self {
        let scale = plan.scale(regions, places);
        let ring = Ring::new(plan.replicas, plan.weight, None);
        let usual = parts(regions, places, plan.replicas, scale, |region| (ring.server(region.id), ALWAYS));
        let at = |minute: usize| usual.iter().map(|part| part.on_the_road(places, minute, 1.0)).sum::<f64>();
        let mut on_road: Vec<_> = (0..MINUTES).map(at).collect();
        let busiest = (0..MINUTES).max_by(|a, b| on_road[*a].total_cmp(&on_road[*b])).unwrap_or_default();
        let day: f64 = on_road.iter().sum();
        for minute in &mut on_road {
            *minute /= day;
        }
        Self { plan, costs, places, uploads, scale, usual, busiest, on_road, regions }
    }

    /// A day with one blow.
    pub fn day(&self, blow: Blow) -> Outcome {
        let lost = self.biggest();
        let [gone, back_again] = self.parts_around_a_loss(blow, lost);
        let mut day = Day::new(self, blow);
        for minute in 0..MINUTES {
            let since = minute.checked_sub(self.busiest);
            let parts = match (blow, since) {
                (Blow::ReplicaLost, Some(since)) if since < GONE_MINUTES => &gone,
                (Blow::ReplicaLost, Some(_)) => &back_again,
                _ => &self.usual,
            };
            let unknown = blow == Blow::ReplicaLost && since == Some(0);
            let hot = blow == Blow::HotCity && since.is_some_and(|since| since < HOT_MINUTES);
            let away = blow == Blow::BucketAway && since == Some(0);
            let unanswered = if unknown { Some(lost) } else { None };
            day.minute(minute, parts, if hot { HOT } else { 1.0 }, unanswered, away);
        }
        day.over()
    }

    /// The replica with the most vehicles in the busiest minute.
    fn biggest(&self) -> usize {
        let load = |part: &Part| part.on_the_road(self.places, self.busiest, 1.0);
        let all = self.usual.iter().map(load).enumerate();
        all.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(at, _)| at)
    }

    fn parts_around_a_loss(&self, blow: Blow, lost: usize) -> [Vec<Part>; 2] {
        if blow != Blow::ReplicaLost {
            return [Vec::new(), Vec::new()];
        }
        let usual = Ring::new(self.plan.replicas, self.plan.weight, None);
        let without = Ring::new(self.plan.replicas, self.plan.weight, Some(lost));
        let (from, until) = (self.busiest as f64, (self.busiest + GONE_MINUTES) as f64);
        let make = |owner: &dyn Fn(&Region) -> (usize, f64)| {
            parts(self.regions, self.places, self.plan.replicas, self.scale, owner)
        };
        let gone = make(&|region: &Region| match usual.server(region.id) {
            server if server == lost => (without.server(region.id), from),
            server => (server, ALWAYS),
        });
        let again = make(&|region: &Region| match usual.server(region.id) {
            server if server == lost => (server, until),
            server => (server, ALWAYS),
        });
        [gone, again]
    }
}

struct Day<'a> {
    simulation: &'a Simulation<'a>,
    outcome: Outcome,
    latencies: Latencies,
    /// How many minutes the caches go back, by replica.
    reach: Vec<f64>,
    spooled_before: f64,
    /// Streets that the balancer sends elsewhere since the city is hot.
    spilled: Option<(f64, Streets)>,
}

impl<'a> Day<'a> {
    fn new(simulation: &'a Simulation<'a>, blow: Blow) -> Self {
        let outcome = Outcome {
            blow,
            asked: 0.0,
            answered: 0.0,
            refused: 0.0,
            unanswered: 0.0,
            p50_ms: 0.0,
            p99_ms: 0.0,
            worst_p99_ms: 0.0,
            worst_share: 0.0,
            mean_cores: 0.0,
            peak_cores: 0.0,
            busiest: 0.0,
            cold_km_s: 0.0,
            uploads: Uploads::default(),
            spools_empty_after: 0,
            acknowledged_ms: 0.0,
            traffic: Traffic::default(),
        };
        let reach = vec![0.0; simulation.plan.replicas];
        let latencies = Latencies::default();
        Self { simulation, outcome, latencies, reach, spooled_before: 0.0, spilled: None }
    }

    fn minute(&mut self, minute: usize, parts: &[Part], city: f64, unknown: Option<usize>, away: bool) {
        let Simulation { plan, places, scale, busiest, .. } = *self.simulation;
        let offered: Vec<_> =
            parts.iter().map(|part| scale.vehicles * part.on_the_road(places, minute, city)).collect();
        let loads = bounded(&offered, plan.factor);
        self.spill(minute, &offered, &loads, city);
        let before = self.outcome.clone();
        let (mut of_minute, mut cores, mut cold) = (Latencies::default(), 0.0, 0.0);
        for (replica, part) in parts.iter().enumerate() {
            if minute.is_multiple_of(REACH_EVERY) || minute == busiest || minute == busiest + GONE_MINUTES {
                let room = plan.cache_gib * 1024.0 * 1.048_576 / self.simulation.costs.prepared_mb_a_km;
                self.reach[replica] = back(&part.streets, &places.visits, minute as f64, room);
            }
            // A vehicle asks once a second.
            let per_s = loads[replica];
            let extra = (per_s - offered[replica]).max(0.0);
            let cold_km_s = self.cold_km_s(minute, part, self.reach[replica], extra);
            cores += self.fixes(per_s, cold_km_s, &mut of_minute);
            cold += cold_km_s;
        }
        if let Some(lost) = unknown {
            let part = &self.simulation.usual[lost];
            self.lose(scale.vehicles * part.on_the_road(places, minute, city) * UNKNOWN_S);
        }
        cores += self.uploads(minute, away);
        let outcome = &mut self.outcome;
        let without = outcome.refused + outcome.unanswered - before.refused - before.unanswered;
        outcome.worst_share = outcome.worst_share.max(without / (outcome.asked - before.asked));
        outcome.worst_p99_ms = outcome.worst_p99_ms.max(of_minute.quantile(0.99));
        outcome.mean_cores += cores / MINUTES as f64;
        outcome.peak_cores = outcome.peak_cores.max(cores);
        outcome.cold_km_s = outcome.cold_km_s.max(cold);
        self.latencies.merge(&of_minute);
    }

    /// What the balancer begins to send elsewhere when the city becomes hot: streets that are cold there.
    fn spill(&mut self, minute: usize, offered: &[f64], loads: &[f64], city: f64) {
        if city <= 1.0 {
            self.spilled = None;
            return;
        }
        let excess: f64 = offered.iter().zip(loads).map(|(offered, load)| (offered - load).max(0.0)).sum();
        let room: f64 = offered.iter().zip(loads).map(|(offered, load)| (load - offered).max(0.0)).sum();
        if excess > 0.0 && self.spilled.is_none() {
            let Simulation { regions, scale, places, .. } = *self.simulation;
            let largest = regions.iter().filter(|region| region.in_largest_city);
            let (roads, place) = largest
                .fold((0.0, 0), |(roads, _), region| (roads + region.road_share, places.of_region(region)));
            let km = roads * scale.road_km;
            let visits_per_km_s = excess * scale.km_per_s / km / places.shares[place][minute];
            self.spilled = Some((room, Streets { km, visits_per_km_s, place, since: minute as f64 }));
        }
    }

    /// Kilometres a second that are prepared by one replica.
    fn cold_km_s(&self, minute: usize, part: &Part, reach: f64, extra: f64) -> f64 {
        let places = self.simulation.places;
        let cold = |street: &Streets| {
            let visits = street.visits_per_km_s * places.shares[street.place][minute];
            street.km * visits * (1.0 - street.warm(&places.visits, minute as f64 + 0.5, reach))
        };
        let own: f64 = part.streets.iter().map(cold).sum();
        // Who has room takes of all streets that are too much for others, in the measure of its room.
        let spilled = self.spilled.map_or(0.0, |(room, street)| {
            cold(&Streets { visits_per_km_s: street.visits_per_km_s * extra / room, ..street })
        });
        own + spilled
    }

    /// One replica's fixes of a minute. Returns its busy cores.
    fn fixes(&mut self, per_s: f64, cold_km_s: f64, of_minute: &mut Latencies) -> f64 {
        let Simulation { plan, costs, .. } = *self.simulation;
        if per_s <= 0.0 {
            return 0.0;
        }
        let cold_share = (cold_km_s * costs.cold_fixes_a_km() / per_s).min(1.0);
        let service_ms = costs.fix_cpu_ms + cold_share * costs.cold_window_ms;
        let queue = Queue { cores: plan.cores, places: PLACES };
        let waiting = queue.offered(per_s, service_ms * 1e-3);
        let answered = per_s * (1.0 - waiting.refused);
        self.outcome.asked += 60.0 * per_s;
        self.outcome.refused += 60.0 * per_s * waiting.refused;
        self.outcome.answered += 60.0 * answered;
        let cores = answered * service_ms * 1e-3;
        self.outcome.busiest = self.outcome.busiest.max(cores / f64::from(plan.cores));
        let longer = |ms: f64| if ms < 0.0 { 1.0 } else { waiting.waits_longer(ms * 1e-3) };
        of_minute.add(60.0 * answered, |ms| {
            let warm_ms = ms - costs.fix_cpu_ms;
            (1.0 - cold_share) * longer(warm_ms) + cold_share * longer(warm_ms - costs.cold_window_ms)
        });
        cores
    }

    /// So many of those that were answered by others were asked of a replica that is gone.
    fn lose(&mut self, fixes: f64) {
        let fixes = fixes.min(self.outcome.answered);
        self.outcome.answered -= fixes;
        self.outcome.unanswered += fixes;
    }

    /// The uploads of a minute. Returns the cores that folding takes: each replica folds all, on one thread.
    fn uploads(&mut self, minute: usize, away: bool) -> f64 {
        let Simulation { plan, costs, uploads, busiest, .. } = *self.simulation;
        let folds = 60_000.0 / costs.upload_cpu_ms;
        let made = uploads * self.simulation.on_road[minute];
        let unfolded = self.outcome.uploads.unfolded;
        let acknowledged = self.outcome.uploads.minute(made, folds, away);
        let folded = acknowledged + unfolded - self.outcome.uploads.unfolded;
        self.outcome.traffic.add_minute(acknowledged, plan.replicas, away, costs);
        let appended = appending(acknowledged / 60.0, plan.replicas, costs);
        self.outcome.acknowledged_ms = self.outcome.acknowledged_ms.max(appended.acknowledged_ms);
        if minute == busiest.saturating_sub(1) {
            self.spooled_before = self.outcome.uploads.spooled;
        }
        if minute >= busiest && self.outcome.uploads.spooled > self.spooled_before {
            self.outcome.spools_empty_after = minute + 1 - busiest;
        }
        folded / 60_000.0 * costs.upload_cpu_ms * plan.replicas as f64
    }

    fn over(mut self) -> Outcome {
        self.outcome.p50_ms = self.latencies.quantile(0.5);
        self.outcome.p99_ms = self.latencies.quantile(0.99);
        self.outcome
    }
}
