//! The figures as a page.

use std::fmt::Write;

use super::super::page::head;
use super::{Demo, History, Town, Waits};
use echofix_harness::percentiles::Percentiles;

/// The figures in Markdown. `command` is the command that measured them.
pub(in super::super) fn page(figures: &Waits, command: &str) -> String {
    let Waits { machine, seed, demo, town, history } = figures;
    let mut page = format!(
        "`{command}`, on {} cores of an {}, {:.0} GiB; the town has seed {seed}. Service and clients share the cores.\n",
        machine.cores, machine.processor, machine.memory_gib,
    );
    page += &head("What people wait for", &["", ""]);
    let mut row = |name: &str, value: String| {
        let _ = writeln!(page, "| {name} | {value} |");
    };
    let both = |ms: &Percentiles| format!("{:.1} / {:.1}", ms.p50, ms.p99);
    let Demo { console_s, first_answer_s, all_s } = demo;
    row("`echofix demo`, until it names the console, s", format!("{console_s:.1}"));
    row("... until the first answer, s", format!("{first_answer_s:.1}"));
    row("... until its report, s", format!("{all_s:.1}"));
    let Town { page_ms, page_kb, files, tiles, tile_ms, tile_again_ms } = town;
    row("the console's page with its files and first data, ms", format!("{page_ms:.0}"));
    row("... kilobytes, in files", format!("{page_kb:.0}, {files}"));
    row(&format!("a tile of {tiles} for the first time, ms, 50 / 99 %"), both(tile_ms));
    row("... once more", both(tile_again_ms));
    let History {
        uploads,
        acknowledged_s,
        folded_s,
        page_ms: looked_ms,
        map_ms,
        feed_ms,
        start_s,
        memory_mb,
    } = history;
    row(&format!("{uploads} small uploads, until all are acknowledged, s"), format!("{acknowledged_s:.0}"));
    row("... until the map shows them, s", format!("{folded_s:.0}"));
    row("... then a page of the history, ms, 50 / 99 %", both(looked_ms));
    row("... the map in numbers", both(map_ms));
    row("... the feed of uploads", both(feed_ms));
    row("... a start on them, until it is ready, s", format!("{start_s:.1}"));
    let memory = memory_mb.map_or("unknown".to_owned(), |mb| format!("{mb:.0}"));
    row("... the service's memory after it, MB", memory);
    page + "\nThe page is loaded over one connection, its files one after the other, and not drawn. A small upload holds 40 cells of one \
            place; 64 are under way at the same time.\n"
}
