//! The map as a caller of `GetTiles` gets it.

use std::collections::BTreeMap;

use echofix_core::geo::{TileId, Zone};
use echofix_proto::v1;
use echofix_proto::v1::get_tiles_request::Selection;
use echofix_proto::v1::get_tiles_response::Part;
use echofix_proto::v1::map_service_client::MapServiceClient;
use echofix_proto::v1::{GeodeticBox, GetTilesRequest, TileVersion, TilesSummary};
use tonic::Status;
use tonic::transport::Channel;

use crate::grpc;
use crate::service::Service;

/// Tiles with their version and their bytes.
pub type Tiles = BTreeMap<TileId, (u64, Vec<u8>)>;

/// Everything, whatever zone it lies in.
pub const EVERYWHERE: GeodeticBox =
    GeodeticBox { south_deg: -90.0, west_deg: -180.0, north_deg: 90.0, east_deg: 180.0 };

/// A map to be compared with that of another service: versions of two lineages differ by as much for every tile.
pub fn but_lineage(mut tiles: Tiles) -> Tiles {
    let first = tiles.values().next().map_or(0, |(version, _)| *version);
    for (version, _) in tiles.values_mut() {
        *version = version.wrapping_sub(first);
    }
    tiles
}

/// Asks for tiles; checks their pieces, and that the summary comes last and counts what was sent.
///
/// # Errors
/// The service's refusal.
pub async fn get(
    client: &mut MapServiceClient<Channel>,
    selection: Selection,
    have: Vec<TileVersion>,
) -> Result<(Tiles, TilesSummary), Status> {
    let request = GetTilesRequest { selection: Some(selection), have, ..GetTilesRequest::default() };
    let mut parts = client.get_tiles(request).await?.into_inner();
    let mut tiles = Tiles::new();
    // The tile that began last, and the bytes it lacks.
    let mut last = None;
    let mut lacking = 0;
    while let Some(part) = parts.message().await? {
        match part.part.expect("a part is a tile, a piece or the summary") {
            Part::Tile(tile) => {
                assert_eq!(lacking, 0, "a tile begins before the last one has ended");
                lacking = rest_after(tile.encoded_bytes, &tile.encoded);
                let version = tile.version.expect("a tile has a version");
                let id = id(&version.tile.expect("a version names its tile"));
                let before = tiles.insert(id, (version.version, tile.encoded));
                assert!(before.is_none(), "tile {id} came twice");
                last = Some(id);
            }
            Part::Piece(piece) => {
                lacking = rest_after(lacking, &piece.encoded);
                let tile = last.as_ref().and_then(|id| tiles.get_mut(id)).expect("a piece follows its tile");
                tile.1.extend(piece.encoded);
            }
            Part::Summary(summary) => {
                assert_eq!((summary.sent as usize, lacking), (tiles.len(), 0));
                assert!(parts.message().await?.is_none(), "the summary is the last message");
                return Ok((tiles, summary));
            }
        }
    }
    panic!("the answer ended without a summary");
}

/// What a tile lacks after a piece, bytes.
fn rest_after(lacking: u64, piece: &[u8]) -> u64 {
    assert!((1..=512 << 10).contains(&piece.len()), "a piece of {} bytes", piece.len());
    lacking.checked_sub(piece.len() as u64).expect("a tile is not longer than it was said to be")
}

/// The whole map.
pub async fn all(service: &Service) -> Tiles {
    let mut client = grpc::reading(service).await;
    get(&mut client, Selection::Area(EVERYWHERE), Vec::new()).await.expect("the map can be read").0
}

/// A tile's id out of its message.
pub fn id(message: &v1::TileId) -> TileId {
    TileId { zone: Zone::from_epsg(message.epsg).expect("a zone of UTM"), x: message.x, y: message.y }
}

/// A tile's id as a message.
pub fn message(id: TileId) -> v1::TileId {
    v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y }
}
