//! Maps of streets to lie below the radar map: a `PMTiles` file, and a service of tiles.

use std::io::{Read, Write};
use std::net::TcpListener;

/// A picture of one grey-green pixel.
const PICTURE: &[u8] = &[
    0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52, 0x00,
    0x00, 0x00, 0x01, 0x00, 0x00, 0x00, 0x01, 0x08, 0x02, 0x00, 0x00, 0x00, 0x90, 0x77, 0x53, 0xde, 0x00,
    0x00, 0x00, 0x0c, 0x49, 0x44, 0x41, 0x54, 0x78, 0xda, 0x63, 0x48, 0x98, 0x50, 0x00, 0x00, 0x02, 0xb4,
    0x01, 0x61, 0x4e, 0xd0, 0x07, 0x6d, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44, 0xae, 0x42, 0x60,
    0x82,
];
/// The last zoom of the file's tiles.
const MAX_ZOOM: u8 = 14;

/// A service that has the same picture for every tile; returns the template of its addresses.
#[must_use]
pub fn service_of_tiles() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("there is a free port");
    let at = listener.local_addr().expect("it is bound");
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { continue };
            let head = format!(
                "HTTP/1.1 200 OK\r\ncontent-type: image/png\r\naccess-control-allow-origin: *\r\ncontent-length: {}\r\n\
                 connection: close\r\n\r\n",
                PICTURE.len()
            );
            // A browser that goes away while it is answered misses nothing.
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(&[head.as_bytes(), PICTURE].concat());
        }
    });
    format!("http://{at}/{{z}}/{{x}}/{{y}}.png")
}

/// A `PMTiles` file, in which every tile of the world has a road from corner to corner and a lake.
#[must_use]
pub fn file() -> Vec<u8> {
    let tile =
        [layer(b"roads", 2, &[9, 0, 0, 10, 0x80, 0x40, 0x80, 0x40]), layer(b"water", 3, LAKE)].concat();
    let about = br#"{"vector_layers":[{"id":"roads","fields":{}},{"id":"water","fields":{}}],"attribution":"<b>Nobody</b>"}"#;
    let tiles = (4_u64.pow(u32::from(MAX_ZOOM) + 1) - 1) / 3;
    // One entry: from tile 0 on, all have the same content.
    let root = [varint(1), varint(0), varint(tiles), varint(tile.len() as u64), varint(1)].concat();
    let mut file = b"PMTiles\x03".to_vec();
    let parts = [(root.len(), &root[..]), (about.len(), &about[..]), (0, &[]), (tile.len(), &tile[..])];
    let mut at = 127;
    for (length, _) in parts {
        file.extend(u64::to_le_bytes(at));
        file.extend((length as u64).to_le_bytes());
        at += length as u64;
    }
    file.extend([tiles, 1, 1].iter().flat_map(|count| count.to_le_bytes()));
    // Clustered; nothing is compressed; vector tiles; the zooms.
    file.extend([1, 1, 1, 1, 0, MAX_ZOOM]);
    let degrees = |value: i32| (value * 10_000_000).to_le_bytes();
    file.extend([-180, -85, 180, 85].map(degrees).concat());
    file.push(0);
    file.extend([0, 0].map(degrees).concat());
    file.extend(parts.iter().flat_map(|(_, bytes)| bytes.iter()));
    file
}

/// Four corners, closed.
const LAKE: &[u8] = &[9, 0x80, 0x10, 0x80, 0x10, 26, 0x80, 0x10, 0, 0, 0x80, 0x10, 0xff, 0x0f, 0, 15];

/// A layer of a vector tile with one feature.
fn layer(name: &[u8], kind: u8, geometry: &[u8]) -> Vec<u8> {
    let field = |tag: u8, bytes: &[u8]| [&[tag][..], &varint(bytes.len() as u64), bytes].concat();
    let feature = [&[0x18, kind][..], &field(0x22, geometry)].concat();
    let layer = [&[0x78, 2][..], &field(0x0a, name), &field(0x12, &feature), &[0x28, 0x80, 0x20]].concat();
    field(0x1a, &layer)
}

fn varint(mut value: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
    bytes
}
