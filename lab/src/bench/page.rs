//! The figures as a page.

use std::fmt::Write;

use super::cold::Cold;
use super::engines::EngineTiming;
use super::inside::{ALIGNED, Inside};
use super::lengths::Length;
use super::load::Load;
use super::lost::Lost;
use super::sizes::Size;
use super::town::UploadCost;
use super::{BenchPlan, Figures};
use echofix_harness::percentiles::Percentiles;

/// The figures in Markdown. `command` is the command that measured them.
pub fn page(figures: &Figures, command: &str) -> String {
    let Figures { plan, machine, loads, refused, cold, inside, engines, .. } = figures;
    let BenchPlan { seed, contributors, questions, load_s, .. } = plan;
    let mut page = format!(
        "`{command}`, on {} cores of an {}, {:.0} GiB. Other work on the machine raises every time, so compare within \
         one run. The town has seed {seed} and {:.1} km of streets, mapped by {contributors} vehicle(s). Another vehicle drives there \
         three days later; each second it sends a request, at most {questions} in all, with a 5 s batch (the median one has {} detections) \
         and a prior of sigma 2 m and 3 deg. Each row of load lasts {load_s:.0} s.\n",
        machine.cores, machine.processor, machine.memory_gib, figures.street_km, figures.detections,
    );
    page += &under_load(loads, refused);
    page += &steps(inside, loads);
    page += &by_engine(engines);
    page += &by_size(&figures.sizes, plan);
    page += &by_length(&figures.lengths);
    page += &of_lost(&figures.lost);
    page += &street(cold);
    page += &of_uploads(&figures.uploads);
    if let Some(Percentiles { p50, p95, p99 }) = figures.error_m {
        let usable = figures.usable_share * 100.0;
        let line = format!(
            "\nUnder load, the fixes had errors of {p50:.2} / {p95:.2} / {p99:.2} m (50 / 95 / 99 %); {usable:.0} % were usable.\n"
        );
        page += &line;
    }
    page
}

/// The heading and the first lines of a table.
pub(crate) fn head(title: &str, columns: &[&str]) -> String {
    let columns_md: String = columns.iter().fold(String::new(), |line, column| line + " | " + column);
    format!("\n## {title}\n\n{} |\n|{}\n", columns_md.trim_start(), "---|".repeat(columns.len()))
}

fn under_load(loads: &[Load], refused: &Load) -> String {
    let columns = [
        "compute threads",
        "clients",
        "fixes/s",
        "fixes/s of a core of the service",
        "CPU ms a fix, service",
        "CPU ms a fix, clients",
        "latency ms, 50 / 99 %",
        "kB, request / answer",
    ];
    let mut table = head("The service under load", &columns);
    let rows = loads.iter().map(|load| (load.threads.to_string(), load));
    for (name, load) in rows.chain([(format!("{}, not aligned", refused.threads), refused)]) {
        let latency = load.latency_ms.map_or(String::new(), |ms| format!("{:.1} / {:.1}", ms.p50, ms.p99));
        let _ = writeln!(
            table,
            "| {name} | {} | {:.1} | {} | {} | {} | {latency} | {:.1} / {:.2} |",
            load.clients,
            load.per_second(),
            or_unknown(load.per_core_second(), 0),
            or_unknown(load.service_ms(), 2),
            or_unknown(load.clients_ms(), 2),
            load.request_kb,
            load.answer_kb
        );
    }
    table
        + "\nThe service is a separate process on the same cores as its clients. Each client sends its next request over loopback \
           gRPC as soon as the last one is answered. \"Not aligned\": the service refuses the same requests after it has organised them.\n"
}

fn or_unknown(value: Option<f64>, digits: usize) -> String {
    value.map_or("unknown".to_owned(), |value| format!("{value:.digits$}"))
}

fn steps(inside: &Inside, loads: &[Load]) -> String {
    let mut table =
        head("Where the time of a request goes", &["step, in process on one thread", "ms, 50 %", "99 %"]);
    for (step, Percentiles { p50, p99, .. }) in &inside.steps {
        let _ = writeln!(table, "| {step} | {p50:.3} | {p99:.3} |");
    }
    let Percentiles { p50, p99, .. } = inside.total_ms;
    let _ = writeln!(table, "| all | {p50:.3} | {p99:.3} |");
    if let Some(whole) = loads.first().and_then(Load::service_ms) {
        let _ =
            writeln!(table, "| a fix of the whole service, mean: sockets and threads, too | {whole:.3} | |");
    }
    table
}

fn by_engine(engines: &[EngineTiming]) -> String {
    let columns = ["engine", "ms a batch, 50 %", "99 %", "times faster", "same maximum"];
    let mut table = head("The search, and the whole fix, by engine", &columns);
    for EngineTiming { name, ms, ratio, identical } in engines {
        let same = identical.map_or_else(|| "-".to_owned(), |(same, all)| format!("{same} of {all}"));
        let _ = writeln!(table, "| {name} | {:.2} | {:.2} | {:.0} | {same} |", ms.p50, ms.p99, 1.0 / ratio);
    }
    table + "\nAllocations are counted by `cargo bench -p echofix-tests`.\n"
}

fn by_size(sizes: &[Size], plan: &BenchPlan) -> String {
    let mut columns = vec!["search, m", "cells of the batch"];
    columns.extend(sizes.first().into_iter().flat_map(|size| &size.ms).map(|(name, _)| *name));
    let mut table = head("Engines by the size of window and batch, ms", &columns);
    for Size { half_width_m, cells, ms } in sizes {
        let _ = write!(table, "| ± {half_width_m} | {cells} |");
        for (_, ms) in ms {
            let _ = write!(table, " {ms:.1} |");
        }
        table.push('\n');
    }
    let batches = plan.sized;
    table
        + &format!(
            "\nMeans of {batches} batch(es), 19 headings. Larger batches contain copies of their detections, scattered by \
             0.6 m. `bounded` hands a batch to `fft` where its bounds exclude too few hypotheses.\n"
        )
}

fn by_length(lengths: &[Length]) -> String {
    let columns =
        ["batch, s", "detections", "kB a request", "aligned, ms", "all in process, ms", "us a detection"];
    let mut table = head("A request by the length of its batch", &columns);
    for Length { batch_s, detections, request_kb, inside } in lengths {
        let (aligned, all) = (inside.step(ALIGNED).map(|ms| ms.p50), inside.total_ms.p50);
        let each = all * 1e3 / *detections as f64;
        let aligned = or_unknown(aligned, 2);
        let _ = writeln!(
            table,
            "| {batch_s} | {detections} | {request_kb:.1} | {aligned} | {all:.2} | {each:.2} |"
        );
    }
    table
}

fn of_lost(lost: &Lost) -> String {
    let Lost { off_m, asked, found, trusted, misled, fix_ms } = lost;
    let ms = fix_ms.map_or(String::new(), |ms| format!("{:.1} / {:.1} / {:.1}", ms.p50, ms.p95, ms.p99));
    format!(
        "\n## Lost vehicles\n\nThe priors are up to {off_m} m off, east and north, with any heading. Relocalization finds the right pose \
         (within 1 m and 3 deg) for {found} of {asked} requests. Its verdict is usable for {trusted} of these, and for {misled} of the \
         others. Search, refinement and verdict take {ms} ms (50 / 95 / 99 %).\n"
    )
}

fn of_uploads(uploads: &UploadCost) -> String {
    let UploadCost { count, kb, cpu_ms } = *uploads;
    let each = |all: f64| all / count.max(1) as f64;
    format!(
        "\n## An upload\n\nThe map was made of {count} uploads of {:.0} kB. Each took {} ms of the service's processor time, to \
         decode it, write it, vet it against the map and fold it.\n",
        each(kb),
        or_unknown(cpu_ms.map(each), 1)
    )
}

fn street(cold: &Cold) -> String {
    let mut table = head("A street for the first time", &["", ""]);
    let mut row = |name: &str, value: String| {
        let _ = writeln!(table, "| {name} | {value} |");
    };
    let both =
        |ms: Option<Percentiles>| ms.map_or(String::new(), |ms| format!("{:.2} / {:.2}", ms.p50, ms.p99));
    row("requests, over km of street", format!("{}, {:.2}", cold.asked, cold.street_km));
    row("ms for the map window of a request, 50 / 99 %", both(cold.window_ms));
    row("... of the same requests again, from the cache", both(cold.cached_ms));
    row("CPU ms a street km, beyond the same requests again", or_unknown(cold.cpu_ms_per_km, 0));
    row("memory of the process once, MB", or_unknown(cold.memory.map(|line| line.once_mb), 1));
    row("... and a street km, MB", or_unknown(cold.memory.map(|line| line.mb_per_km), 2));
    table
}
