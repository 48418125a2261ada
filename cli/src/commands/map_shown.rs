//! What `echofix map ...` prints for people.

use serde_json::Value;

/// The history, newest first.
pub(super) fn history(body: &Value) {
    for event in body["events"].as_array().into_iter().flatten() {
        let (first, last, date) =
            (&event["first"], &event["last"], event["date"].as_str().unwrap_or_default());
        let kind = event["kind"].as_str().unwrap_or_default().replace('_', " ");
        let epochs = if first == last { last.to_string() } else { format!("{first}-{last}") };
        let what = if event["uploads"].is_u64() {
            format!("{} {kind} of {} contributors", event["uploads"], event["contributors"])
        } else if event["tiles"].is_u64() {
            format!("{kind} of {} tiles, file {}", event["tiles"], event["file"].as_str().unwrap_or_default())
        } else {
            match &event["of"] {
                Value::Null => kind,
                Value::String(of) => format!("{kind} {of}"),
                of => format!("{kind} {of}"),
            }
        };
        let word = |key: &str| event[key].as_str().map(str::to_owned);
        let kept_out = event["quarantined"].as_u64().filter(|count| *count > 0);
        let kept_out = kept_out.map(|count| format!("; {count} of them in quarantine")).unwrap_or_default();
        let undone = event["undone_by"].as_u64().map(|by| format!("; undone by {by}")).unwrap_or_default();
        let by = word("by").map(|by| format!("; by {by}")).unwrap_or_default();
        let why = word("reason").map(|reason| format!("; \"{reason}\"")).unwrap_or_default();
        let back = [
            ("taken_back", "taken back"),
            ("takes_back", "taken back by it"),
            ("gives_back", "given back by it"),
        ];
        let back = back.iter().find_map(|(key, words)| Some((event[*key].as_u64()?, words)));
        let back = back.filter(|(count, _)| *count > 0).map(|(count, words)| format!("; {count} {words}"));
        println!("{epochs:>15}  {date}  {what}{kept_out}{}{by}{why}{undone}", back.unwrap_or_default());
    }
}

/// What vetting kept out, and alarms.
pub(super) fn quarantine(body: &Value) {
    println!("{} uploads are in quarantine", body["quarantined"]);
    for upload in body["uploads"].as_array().into_iter().flatten() {
        let word = |key: &str| upload[key].as_str().unwrap_or_default().to_lowercase();
        let epoch = upload["epoch"].to_string();
        println!(
            "{epoch:>9}  {}  {:<10} {}  {}  upload {} of contributor {}",
            word("date"),
            word("reason"),
            place(upload),
            offset(upload),
            upload["upload_id"].as_str().unwrap_or("(compacted)"),
            word("contributor"),
        );
    }
    alarms_of(body).for_each(|line| println!("{line}"));
}

/// Where several contributors disagree with the map alike.
pub(super) fn alarms(body: &Value) {
    let lines: Vec<_> = alarms_of(body).collect();
    if lines.is_empty() {
        println!("there is no alarm; {} uploads are in quarantine", body["quarantined"]);
    }
    for line in lines {
        println!("{line}");
    }
}

/// A line for each alarm.
pub(super) fn alarms_of(body: &Value) -> impl Iterator<Item = String> {
    body["alarms"].as_array().into_iter().flatten().map(|alarm| {
        let since = alarm["since"].as_str().unwrap_or_default();
        let by =
            if alarm["kind"] == "SHIFT" { offset(alarm) } else { "something else than the map".to_owned() };
        format!("ALARM: {} contributors agree at {} since {since}: {by}", alarm["contributors"], place(alarm))
    })
}

fn place(of: &Value) -> String {
    match (of["place"]["lat"].as_f64(), of["place"]["lon"].as_f64()) {
        (Some(lat), Some(lon)) => format!("{lat:.6} {lon:.6}"),
        _ => "an unknown place".to_owned(),
    }
}

fn offset(of: &Value) -> String {
    match (of["offset"]["east_m"].as_f64(), of["offset"]["north_m"].as_f64()) {
        (Some(east), Some(north)) => format!("{east:+.2} m east, {north:+.2} m north"),
        _ => String::new(),
    }
}

/// How two maps differ.
pub(super) fn diff(body: &Value) {
    let cells =
        |of: &Value| format!("{} added, {} removed, {} changed", of["added"], of["removed"], of["changed"]);
    println!("{} tiles differ; cells: {}", body["tiles_changed"], cells(&body["cells"]));
    for tile in body["tiles"].as_array().into_iter().flatten() {
        println!("  {}: {}", tile["id"].as_str().unwrap_or_default(), cells(tile));
    }
}

/// Whether the store is sound.
pub(super) fn verified(body: &Value) {
    let sound = if body["sound"] == true { "the store is sound" } else { "the store is DAMAGED" };
    println!(
        "{sound}: {} records, {} compacted tiles and {} tiles were read",
        body["records"], body["base_tiles"], body["tiles"]
    );
    if let Some(compared) = body["compared"].as_u64() {
        println!("{compared} tiles were compared with those of the journal, folded again");
    }
    for damage in body["damage"].as_array().into_iter().flatten() {
        println!("  {}", damage.as_str().unwrap_or_default());
    }
}

/// What came of a decision, or would.
pub(super) fn decided(body: &Value) {
    let change = &body["dry_run"];
    if !change.is_null() {
        println!("nothing was decided; it would change:");
        for line in foretold(change) {
            println!("  {line}");
        }
    } else if let Some(epoch) = body["epoch"].as_u64() {
        println!("decided: the map shows it from epoch {epoch} on");
    } else {
        println!("there was nothing to decide");
    }
}

/// What a decision would change, line by line.
pub(super) fn foretold(change: &Value) -> Vec<String> {
    let pair = |of: &Value| format!("{} taken back, {} given back", of["taken_back"], of["given_back"]);
    let cells = &change["cells"];
    let undone = if change["can_be_undone"] == true {
        "`echofix map undo` takes this back.".to_owned()
    } else {
        format!("{} uploads are compacted. This CANNOT be undone.", change["compacted"])
    };
    vec![
        format!("uploads:        {} (of {} contributors)", pair(&change["uploads"]), change["contributors"]),
        format!("imported tiles: {}", pair(&change["imported_tiles"])),
        format!(
            "cells:          {} added, {} removed, {} changed, in {} tiles",
            cells["added"], cells["removed"], cells["changed"], change["tiles_changed"]
        ),
        undone,
    ]
}

/// An imported file.
pub(super) fn imported(body: &Value) {
    println!(
        "{} tiles, {} of them known already; the map shows them from epoch {} on",
        body["tiles"], body["known"], body["epoch"]
    );
    println!("the file's id is {}", body["file"].as_str().unwrap_or_default());
}

/// A file that was written.
pub(super) fn written(body: &Value) {
    println!("{:.1} kB written", body["bytes"].as_f64().unwrap_or_default() / 1e3);
}
