//! The figures as a page.

use std::fmt::Write;

use super::simulation::{Blow, Outcome};
use super::wanted::Told;
use super::{Costs, Figures, Plan};
use crate::bench::head;

/// Days of a month, for what is paid by month.
const MONTH: f64 = 30.0;
/// Uploads stay in the journal so many days (`mapping.retention_days`).
const RETENTION: f64 = 90.0;

/// The figures in Markdown.
pub(super) fn page(figures: &Figures) -> String {
    let Figures { plan, costs, regions, .. } = figures;
    let factor = plan.factor.map_or("none".to_owned(), |factor| format!("{factor}"));
    let mut page = format!(
        "`{}`: {:.0} vehicles on the road in the busiest minute, each asking once a second, on {:.0} km of road in {regions} \
         routing regions, at {:.0} km/h; {} replicas of {} cores with {:.0} GiB for prepared tiles, behind HAProxy with servers of \
         weight {} and a balance factor of {factor}.\n",
        command(plan),
        plan.vehicles,
        plan.road_km,
        plan.speed_kmh,
        plan.replicas,
        plan.cores,
        plan.cache_gib,
        plan.weight,
    );
    page += &days(figures);
    page += &paid(figures);
    page += &wanted(figures);
    page += &balance(figures);
    page += &limits(plan, costs);
    page
}

fn command(plan: &Plan) -> String {
    format!(
        "echofix sizing --seed {} --vehicles {} --road-km {} --replicas {} --cores {} --cache-gib {} --told {}",
        plan.seed,
        plan.vehicles,
        plan.road_km,
        plan.replicas,
        plan.cores,
        plan.cache_gib,
        format!("{:?}", plan.told).to_lowercase(),
    )
}

fn name(blow: Blow) -> &'static str {
    match blow {
        Blow::Nothing => "usual",
        Blow::ReplicaLost => "the busiest replica lost for an hour",
        Blow::BucketAway => "the bucket away for a minute",
        Blow::HotCity => "three times the vehicles in the largest city for two hours",
    }
}

type Row = (&'static str, fn(&Outcome) -> String);

const ROWS: [Row; 16] = [
    ("fixes asked, 1e9", |day| format!("{:.2}", day.asked * 1e-9)),
    ("... refused for the moment", |day| part(day.refused, day.asked)),
    ("... asked of a lost replica before the balancer knew", |day| part(day.unanswered, day.asked)),
    ("ms a fix, 50 / 99 %, without network", |day| format!("{:.1} / {:.1}", day.p50_ms, day.p99_ms)),
    ("... 99 % in the worst minute", |day| format!("{:.0}", day.worst_p99_ms)),
    ("without an answer in the worst minute", |day| part(day.worst_share, 1.0)),
    ("busy cores, mean / busiest minute", |day| format!("{:.0} / {:.0}", day.mean_cores, day.peak_cores)),
    ("busiest replica, of its cores", |day| format!("{:.0} %", day.busiest * 100.0)),
    ("km prepared a second, worst minute", |day| format!("{:.0}", day.cold_km_s)),
    ("uploads made / acknowledged", |day| {
        format!("{:.0} / {:.0}", day.uploads.made, day.uploads.folded + day.uploads.unfolded)
    }),
    ("... lost", |day| format!("{:.0}", day.uploads.lost().abs())),
    ("... in spools at most, after refusals", |day| format!("{:.0}", day.uploads.most_spooled)),
    ("... minutes until spools are as empty as before", |day| format!("{}", day.spools_empty_after)),
    ("... ms until acknowledged, busiest minute", |day| format!("{:.0}", day.acknowledged_ms)),
    ("requests to the bucket, millions: put / get", |day| {
        format!("{:.2} / {:.2}", day.traffic.puts * 1e-6, day.traffic.gets * 1e-6)
    }),
    ("GB to / from the bucket", |day| format!("{:.0} / {:.0}", day.traffic.gb_written, day.traffic.gb_read)),
];

fn part(part: f64, of: f64) -> String {
    let share = part / of * 100.0;
    if share == 0.0 {
        "0".to_owned()
    } else if share < 0.000_1 {
        "< 0.0001 %".to_owned()
    } else {
        format!("{share:.4} %")
    }
}

fn days(figures: &Figures) -> String {
    let columns: Vec<_> =
        ["a day"].into_iter().chain(figures.days.iter().map(|day| name(day.blow))).collect();
    let mut table = head("A day", &columns);
    for (row, value) in ROWS {
        let values = figures.days.iter().fold(String::new(), |line, day| line + " " + &value(day) + " |");
        let _ = writeln!(table, "| {row} |{values}");
    }
    table
}

/// What is paid: for replicas that each hold the whole map, and were it divided among them.
fn paid(figures: &Figures) -> String {
    let Figures { plan, costs, days, .. } = figures;
    let Some(day) = days.first() else { return String::new() };
    let mut table = head("Paid for", &["of all replicas", "amount", "dollars a day"]);
    let replicas = plan.replicas as f64;
    let cores = replicas * f64::from(plan.cores);
    let index_gib = day.uploads.made * RETENTION * costs.index_bytes_an_upload / f64::from(1 << 30);
    let gib = replicas * (plan.cache_gib + costs.process_mb / 1024.0 + index_gib);
    let map_tb = plan.road_km * costs.map_mb_a_km * 1e-6;
    let disk_tb = map_tb * costs.disk_mb_a_encoded_mb;
    let journal_tb = day.uploads.made * RETENTION * costs.upload_kb * 1e-9;
    let on_disks = replicas * (disk_tb + journal_tb);
    let to_vehicles_tb = day.answered * costs.answer_kb * 1e-9;
    let requests = day.traffic.puts * costs.put_1000 * 1e-3 + day.traffic.gets * costs.get_1000 * 1e-3;
    let disk_price = |tb: f64| tb * 1e3 * costs.gb_disk_month / MONTH;
    let rows = [
        ("cores", format!("{cores:.0}"), cores * 24.0 * costs.core_hour),
        (
            "memory, with the journals' indices",
            format!("{:.1} TiB", gib / 1024.0),
            gib * 24.0 * costs.gib_memory_hour,
        ),
        (
            "disks: each replica a copy of the map and the journal",
            format!("{on_disks:.0} TB"),
            disk_price(on_disks),
        ),
        (
            "the bucket: packs and journal",
            format!("{:.1} TB", map_tb + journal_tb),
            (map_tb + journal_tb) * 1e3 * costs.gb_bucket_month / MONTH,
        ),
        (
            "requests to the bucket",
            format!("{:.1} million", (day.traffic.puts + day.traffic.gets) * 1e-6),
            requests,
        ),
        (
            "answers to vehicles",
            format!("{to_vehicles_tb:.1} TB"),
            to_vehicles_tb * 1e3 * costs.gb_to_vehicles,
        ),
    ];
    for (row, amount, dollars) in &rows {
        let _ = writeln!(table, "| {row} | {amount} | {dollars:.0} |");
    }
    let sum: f64 = rows.iter().map(|(_, _, dollars)| dollars).sum();
    let divided = sum - disk_price(on_disks) + disk_price(disk_tb + journal_tb);
    let folding = day.uploads.made * costs.upload_cpu_ms * 1e-3 / 86_400.0;
    let _ = writeln!(
        table,
        "\n{sum:.0} dollars a day, {:.4} a vehicle, without questions' bytes ({:.1} PB, {:.0} Gbit/s in the busiest minute). Folding takes \
         {:.1} of the busy cores, since each replica folds all; were map and folding divided among them (they are not), it would take \
         {folding:.2}, the disks {:.0} TB, and all {divided:.0} dollars.",
        sum / plan.vehicles,
        day.asked * costs.question_kb * 1e-12,
        plan.vehicles * costs.question_kb * 8e-6,
        folding * replicas,
        disk_tb + journal_tb,
    );
    table
}

fn wanted(figures: &Figures) -> String {
    let costs = &figures.costs;
    let columns = [
        "vehicles learn what is wanted",
        "uploads a day",
        "of all",
        "of what one replica's folding thread can do",
        "days to map all roads at first",
    ];
    let mut table = head("What is wanted", &columns);
    let all = figures.demanded.iter().find(|told| told.told == Told::Nothing).map_or(1.0, |told| told.a_day);
    let folds_a_day = 86_400e3 / costs.upload_cpu_ms;
    for demanded in &figures.demanded {
        let words = match demanded.told {
            Told::Nothing => "not at all",
            Told::Uploads => "by answers to their own uploads",
            Told::Coverage => "by `GetCoverage` of their way when they set out",
        };
        let first = if demanded.told == Told::Nothing {
            "-".to_owned()
        } else {
            format!("{:.0}", demanded.at_first / folds_a_day)
        };
        let _ = writeln!(
            table,
            "| {words} | {:.2} million | {:.2} % | {:.2} times | {first} |",
            demanded.a_day * 1e-6,
            demanded.a_day / all * 100.0,
            demanded.a_day / folds_a_day,
        );
    }
    table
}

fn balance(figures: &Figures) -> String {
    let mut table = head(
        "Who gets how much",
        &[
            "regions are sent by",
            "vehicles of the busiest replica over the mean",
            "regions of the one with most",
        ],
    );
    for balance in &figures.balances {
        let _ = writeln!(table, "| {} | {:.2} | {:.2} |", balance.name, balance.vehicles, balance.regions);
    }
    let unbounded = &figures.unbounded;
    let _ = writeln!(
        table,
        "\nRegions with many vehicles decide more than the hash does. Without a balance factor, {} of the hot city's day is refused, and {} \
         in its worst minute.",
        part(unbounded.refused, unbounded.asked),
        part(unbounded.worst_share, 1.0),
    );
    table
}

fn limits(plan: &Plan, costs: &Costs) -> String {
    format!(
        "\n## What it leaves out\n\nThe network and the balancer's own work. A process with {} cores: `echofix bench` measured two. \
         Cities, roads and the day's curve are assumed (`lab/src/sizing/country.rs`, `day.rs`). A pack is one object, here of {:.1} TB, \
         which no store takes in one request (5 GB is usual): compaction of such a map needs the parts that it does not have yet. A replica \
         without a copy needs those bytes before it serves.\n",
        plan.cores,
        plan.road_km * costs.map_mb_a_km * 1e-6,
    )
}
