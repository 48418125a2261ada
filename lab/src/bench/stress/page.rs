//! The figures as a page.

use std::fmt::Write;

use super::super::page::head;
use super::{Beside, Offered, Stress};
use echofix_harness::percentiles::Percentiles;

/// The figures in Markdown. `command` is the command that measured them.
pub(in super::super) fn page(figures: &Stress, command: &str) -> String {
    let Stress { machine, seed, beside, .. } = figures;
    let mut page = format!(
        "`{command}`, on {} cores of an {}, {:.0} GiB; the town has seed {seed}. Service and clients share the cores.\n",
        machine.cores, machine.processor, machine.memory_gib,
    );
    page += &of_beside(beside);
    page += &of_overload(figures);
    page
}

fn of_beside(beside: &Beside) -> String {
    let Beside { alone_ms, disturbed_ms, uploads, pictures, verified, seconds } = beside;
    let mut table =
        head("A fix beside all else", &["one vehicle asks, every 20 ms", "latency ms, 50 %", "95 %", "99 %"]);
    let mut row = |name: &str, ms: &Percentiles, digits: usize| {
        let Percentiles { p50, p95, p99 } = ms;
        let _ = writeln!(table, "| {name} | {p50:.digits$} | {p95:.digits$} | {p99:.digits$} |");
    };
    row("alone", alone_ms, 1);
    row("beside all else", disturbed_ms, 1);
    let times = Percentiles {
        p50: disturbed_ms.p50 / alone_ms.p50,
        p95: disturbed_ms.p95 / alone_ms.p95,
        p99: disturbed_ms.p99 / alone_ms.p99,
    };
    row("times as long", &times, 2);
    table
        + &format!(
            "\nAll else is 16 vehicles that upload scans of the same streets without pause, which are built, vetted and folded, a page \
             that draws the map, and an operator who verifies it again and again, folding the journal anew: in {seconds:.0} s \
             {uploads} uploads, {pictures} pictures and {verified} verifications that ended within 5 s.\n"
        )
}

fn of_overload(figures: &Stress) -> String {
    let columns = [
        "offered, times the capacity",
        "requests/s",
        "answered in time/s",
        "of the capacity",
        "ms, 50 / 99 %",
        "refused/s",
        "ms, 50 / 99 %",
        "late or lost/s",
        "memory at most, MB",
    ];
    let mut table = head("More than the service can do", &columns);
    let both =
        |ms: &Option<Percentiles>| ms.map_or(String::new(), |ms| format!("{:.0} / {:.0}", ms.p50, ms.p99));
    for offered in &figures.offered {
        let Offered { multiple, per_s, answered_per_s, refused_per_s, lost_per_s, most_mb, .. } = offered;
        let share = 100.0 * answered_per_s / figures.capacity_per_s;
        let _ = writeln!(
            table,
            "| {multiple:.0} | {per_s:.0} | {answered_per_s:.0} | {share:.0} % | {} | {refused_per_s:.0} | {} | {lost_per_s:.0} | {most_mb:.0} |",
            both(&offered.answered_ms),
            both(&offered.refused_ms),
        );
    }
    table
        + &format!(
            "\nAn open loop over 32 connections: requests of {:.0} kB come at a rate, whether or not those before were answered. The \
             capacity, {:.0} answers a second, is that of 8 clients which wait for their answers. An answer is in time within 1 s.\n",
            figures.request_kb, figures.capacity_per_s
        )
}
