//! `MapService.GetTiles`: the tiles a caller lacks, in order and in pieces, then a summary.

mod area;

use std::collections::{BTreeMap, BTreeSet};
use std::iter;
use std::sync::Arc;

use echofix_core::geo::{TileId, Zone};
use echofix_core::tile::{Grain, encode_layer};
use echofix_proto::v1::get_tiles_request::Selection;
use echofix_proto::v1::get_tiles_response::Part;
use echofix_proto::v1::{
    self, GetTilesRequest, GetTilesResponse, TileData, TileForm, TilePiece, TilesSummary,
};
use prost::Message;
use tokio::sync::{Semaphore, mpsc};
use tokio_stream::wrappers::ReceiverStream;
use tonic::Status;
use tracing::Instrument;

use super::invalid_field::{InvalidField, require, required};
use super::{blocking, status, tile_id};
use crate::pace::Pace;
use crate::shares::Place;
use crate::store::{self, MapStore, StoredTile};

/// Tiles asked for by id, at most.
const MAX_IDS: usize = 1_024;
/// Tiles of an area, at most.
const MAX_AREA: usize = 4_096;
/// Versions a caller may say it has.
const MAX_HAVE: usize = 16_384;
/// Bytes of a tile that go into one message, at most.
const MAX_PIECE: usize = 512 << 10;

/// The answer, as fast as the caller takes it.
pub(super) type TileStream = ReceiverStream<Result<GetTilesResponse, Status>>;

/// What to send.
struct TransferPlan {
    form: TileForm,
    /// Read before any tile: every tile is at least as new.
    epoch: u64,
    send: Vec<TileId>,
    unchanged: u32,
    absent: Vec<TileId>,
}

/// Reads the map, so many at a time. A permit is held for one reading, and never while the caller takes what was read.
pub(super) struct Reader {
    pub(super) store: Arc<dyn MapStore>,
    pub(super) reads: Arc<Semaphore>,
}

impl Reader {
    async fn read<T: Send + 'static>(
        &self,
        read: impl FnOnce(&dyn MapStore) -> Result<T, Status> + Send + 'static,
    ) -> Result<T, Status> {
        let permit = self.reads.clone().acquire_owned().await.map_err(|_| status::gone())?;
        let store = self.store.clone();
        blocking(move || {
            let _held = permit;
            read(&*store)
        })
        .await?
    }
}

pub(super) async fn get_tiles(
    reader: Reader,
    request: GetTilesRequest,
    place: Place,
    pace: Pace,
) -> Result<TileStream, Status> {
    let plan = reader.read(move |store| plan(store, request)).await?;
    let (sender, receiver) = mpsc::channel(1);
    let sending = async move {
        // The caller's place is returned once the answer has ended.
        let _place = place;
        send(reader, plan, sender, pace).await;
    };
    tokio::spawn(sending.in_current_span());
    Ok(ReceiverStream::new(receiver))
}

/// Sends until the end, the first error, or the caller takes nothing any more.
async fn send(
    reader: Reader,
    plan: TransferPlan,
    sender: mpsc::Sender<Result<GetTilesResponse, Status>>,
    pace: Pace,
) {
    let mut summary = TilesSummary {
        epoch: plan.epoch,
        sent: 0,
        unchanged: plan.unchanged,
        absent: plan.absent.into_iter().map(tile_id).collect(),
    };
    for id in plan.send {
        let read = reader.read(move |store| {
            let tile = store.tile(id).map_err(|error| status::store(&error))?;
            Ok(tile.map(|tile| (store.wire_version(tile.version), encoded(&tile, plan.form))))
        });
        let (version, encoded) = match read.await {
            Ok(Some(read)) => read,
            // Taken back since the catalog was asked.
            Ok(None) => {
                summary.absent.push(tile_id(id));
                continue;
            }
            Err(status) => {
                // A caller that went away needs no reason.
                let _ = sender.send_timeout(Err(status), pace.stall).await;
                return;
            }
        };
        summary.sent += 1;
        for part in parts(id, &encoded, version) {
            let message = GetTilesResponse { part: Some(part) };
            let patience = pace.stall + pace.time_for(message.encoded_len());
            if sender.send_timeout(Ok(message), patience).await.is_err() {
                return;
            }
        }
    }
    let last = GetTilesResponse { part: Some(Part::Summary(summary)) };
    // A caller that went away needs no summary.
    let _ = sender.send_timeout(Ok(last), pace.stall).await;
}

/// The bytes of a tile in a form.
fn encoded(tile: &StoredTile, form: TileForm) -> Vec<u8> {
    match form {
        TileForm::Whole => tile.encoded(),
        TileForm::Layer => encode_layer(&tile.tile, &Grain::VEHICLE),
    }
}

/// A tile as messages, each made when it is its turn.
fn parts(id: TileId, encoded: &[u8], version: u64) -> impl Iterator<Item = Part> {
    let first = TileData {
        version: Some(v1::TileVersion { tile: Some(tile_id(id)), version }),
        encoded: encoded[..encoded.len().min(MAX_PIECE)].to_vec(),
        encoded_bytes: encoded.len() as u64,
    };
    let rest = (1..encoded.len().div_ceil(MAX_PIECE)).map(move |number| {
        let piece = encoded.chunks(MAX_PIECE).nth(number).unwrap_or_default();
        Part::Piece(TilePiece { encoded: piece.to_vec() })
    });
    iter::once(Part::Tile(first)).chain(rest)
}

fn plan(store: &dyn MapStore, request: GetTilesRequest) -> Result<TransferPlan, Status> {
    let epoch = store.progress().borrow().epoch;
    let have = have(request.have).map_err(|violation| status::invalid(&violation))?;
    let form = TileForm::try_from(request.form)
        .map_err(|_| status::invalid(&InvalidField::new("form", "is no form that this service knows")))?;
    let selection = required(request.selection, "selection").map_err(|v| status::invalid(&v))?;
    let (mut plan, mut asked) =
        (TransferPlan { form, epoch, send: Vec::new(), unchanged: 0, absent: Vec::new() }, BTreeSet::new());
    let found = match selection {
        Selection::Tiles(list) => {
            asked.extend(ids(&list.ids, "tiles.ids").map_err(|violation| status::invalid(&violation))?);
            let info = |id: &TileId| store.catalog(id.zone, id.x..=id.x, id.y..=id.y);
            let found: Result<Vec<_>, store::Error> = asked.iter().map(info).collect();
            found.map_err(|error| status::store(&error))?.concat()
        }
        Selection::Area(area) => area::tiles(store, &area)?,
    };
    let found: BTreeMap<TileId, u64> =
        found.into_iter().map(|info| (info.id, store.wire_version(info.version))).collect();
    asked.extend(found.keys());
    for id in &asked {
        match (found.get(id), have.get(id)) {
            (Some(version), Some(has)) if version == has => plan.unchanged += 1,
            (Some(_), _) => plan.send.push(*id),
            (None, _) => plan.absent.push(*id),
        }
    }
    for id in have.keys().filter(|id| !asked.contains(id)) {
        if store.catalog(id.zone, id.x..=id.x, id.y..=id.y).map_err(|error| status::store(&error))?.is_empty()
        {
            plan.absent.push(*id);
        }
    }
    Ok(plan)
}

fn have(have: Vec<v1::TileVersion>) -> Result<BTreeMap<TileId, u64>, InvalidField> {
    let most = format!("names more than {MAX_HAVE} tiles");
    require(have.len() <= MAX_HAVE, "have", &most)?;
    let entry = |(row, has): (usize, v1::TileVersion)| {
        let field = format!("have[{row}].tile");
        Ok((id(&required(has.tile, &field)?, &field)?, has.version))
    };
    have.into_iter().enumerate().map(entry).collect()
}

fn ids(ids: &[v1::TileId], field: &str) -> Result<Vec<TileId>, InvalidField> {
    require(ids.len() <= MAX_IDS, field, &format!("names more than {MAX_IDS} tiles"))?;
    ids.iter().enumerate().map(|(row, tile)| id(tile, &format!("{field}[{row}]"))).collect()
}

pub(super) fn id(id: &v1::TileId, field: &str) -> Result<TileId, InvalidField> {
    let zone = Zone::from_epsg(id.epsg).map_err(|error| InvalidField::new(format!("{field}.epsg"), error))?;
    Ok(TileId { zone, x: id.x, y: id.y })
}
