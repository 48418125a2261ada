//! What vetting kept out of the map, and what several contributors agree on.

use std::collections::BTreeSet;
use std::sync::Arc;

use axum::extract::{Extension, State};
use axum::response::Response;
use echofix_core::datum::Offset;
use echofix_core::geo::{Grid, Zone};
use echofix_core::point::MapPoint;
use echofix_core::vetting::Reason;
use echofix_core::vetting::alarm::{Alarm, AlarmKind, alarms};
use serde_json::{Value, json};
use uuid::Uuid;

use super::App;
use super::answers::{AlarmAnswer, BUSY, ErrorAnswer, QuarantineAnswer};
use super::contributor::hash_word;
use super::day::iso_date;
use super::error::Error;
use super::operations::fresh;
use crate::feed::{MapOffset, Place, QuarantineEvent, Watched};
use crate::identity::{Caller, Role};
use crate::shares::Peer;
use crate::store::QuarantinedRecord;

/// Uploads that are listed, at most.
const MAX_LISTED: usize = 10_000;

/// `GET /api/v1/map/quarantine`: uploads that were kept out of the map, newest first, and what they agree on
#[utoipa::path(
    get,
    path = "/api/v1/map/quarantine",
    operation_id = "getQuarantine",
    tag = "history",
    summary = "Uploads that vetting kept out of the map, and what they agree on.",
    description = "",
    responses(
        (status = 200, description = "Newest first; the newest 10 000 of them.", body = QuarantineAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn quarantine(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
) -> Result<Response, Error> {
    let limits = app.state.alarm_limits;
    let operations = Arc::clone(&app.state.operations);
    let read = app.limiter.work(peer, move || {
        let kept_out = operations.quarantined()?;
        let entries: Vec<_> = kept_out.iter().map(|quarantined| quarantined.upload).collect();
        let listed = kept_out.iter().rev().take(MAX_LISTED).map(|record| record.number).collect();
        Ok((kept_out, operations.upload_ids(&listed), alarms(&entries, &limits)))
    });
    let (kept_out, ids, alarms) = read.await?;
    let mut alarms: Vec<_> = alarms.iter().map(alarm_answer).collect();
    let newest = kept_out.iter().rev().take(MAX_LISTED);
    let events = newest.map(|record| quarantine_event(record, ids.get(&record.number).copied()));
    let uploads = if caller.may(Role::Operator) {
        events.collect()
    } else {
        for alarm in &mut alarms {
            alarm.place = alarm.place.map(Place::coarse);
        }
        events.filter_map(|event| event.for_viewers()).collect()
    };
    Ok(fresh(QuarantineAnswer { quarantined: kept_out.len(), uploads, alarms }))
}

/// An entry of the quarantine, as it is listed and as it is told.
pub fn quarantine_event(record: &QuarantinedRecord, id: Option<Uuid>) -> QuarantineEvent {
    let upload = &record.upload;
    QuarantineEvent {
        epoch: record.number,
        upload_id: id.map(|id| id.to_string()),
        contributor: Some(hash_word(upload.contributor)),
        reason: reason_word(record.reason),
        date: iso_date(upload.day),
        place: place(upload.zone, upload.position),
        offset: upload.offset.as_ref().map(map_offset),
        offset_m: upload.offset.map(|offset| offset.pose().x_m.hypot(offset.pose().y_m)),
    }
}

/// Why vetting kept an upload out, in one word.
fn reason_word(reason: Reason) -> &'static str {
    match reason {
        Reason::Shifted => "SHIFTED",
        Reason::Rotated => "ROTATED",
        Reason::Disagrees => "DISAGREES",
    }
}

/// An alarm as it is listed, and told.
fn alarm_answer(alarm: &Alarm) -> AlarmAnswer {
    let (kind, offset) = match &alarm.kind {
        AlarmKind::Shift(by) => ("SHIFT", Some(map_offset(by))),
        AlarmKind::Changed => ("CHANGED", None),
    };
    let (contributors, since) = (alarm.contributors, iso_date(alarm.since));
    AlarmAnswer { kind, offset, contributors, since, place: place(alarm.zone, alarm.position) }
}

/// An alarm as the webhook is told: what it is, where, how many agree, who, and where to look.
pub fn alarm_message(
    alarm: &Alarm,
    (kept_out, within_m): (&[QuarantinedRecord], f64),
    console: &str,
) -> Value {
    let near = kept_out
        .iter()
        .map(|record| record.upload)
        .filter(|upload| upload.zone == alarm.zone && upload.position.distance_m(alarm.position) <= within_m);
    let near: BTreeSet<_> = near.map(|upload| hash_word(upload.contributor)).collect();
    // Our own plain structs always have a JSON form.
    let mut message = serde_json::to_value(alarm_answer(alarm)).unwrap_or_default();
    message["count"] = message["contributors"].take();
    message["contributors"] = json!(near);
    message["service"] = json!("echofix");
    message["link"] = (!console.is_empty()).then(|| link(console, place(alarm.zone, alarm.position))).into();
    message
}

/// Where the console shows a place.
fn link(console: &str, at: Option<Place>) -> String {
    let view = at.map(|at| format!("#view=18/{:.6}/{:.6}", at.lat, at.lon)).unwrap_or_default();
    format!("{}/{view}", console.trim_end_matches('/'))
}

fn map_offset(offset: &Offset) -> MapOffset {
    let pose = offset.pose();
    MapOffset { east_m: pose.x_m, north_m: pose.y_m, yaw_deg: pose.yaw_rad.to_degrees() }
}

/// WGS-84 degrees of a point; nothing where the zone does not reach.
fn place(zone: Zone, point: MapPoint) -> Option<Place> {
    let at = Grid::new(zone).and_then(|grid| grid.unproject(point)).ok()?;
    Some(Place { lat: at.lat_deg, lon: at.lon_deg })
}
