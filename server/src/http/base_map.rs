//! The map of streets below the radar map, where one is configured: tiles of another service, or a `PMTiles` file that this one
//! hands out in ranges. By default there is none, and the console asks nobody else for anything.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::UNIX_EPOCH;

use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use http_range_header::parse_range_header;

use super::App;
use super::answers::{BUSY, BaseMapAnswer, ErrorAnswer};
use super::cors::is_origin;
use super::error::Error;
use super::operations::fresh;
use crate::shares::Peer;

/// Bytes of the file that are read at once, at most: tiles and directories are far smaller.
const LONGEST_RANGE: u64 = 8 << 20;
/// How a `PMTiles` file of the third version begins.
const MAGIC: &[u8; 8] = b"PMTiles\x03";
/// Where the file is found, relative to the console.
const FILE: &str = "base-map.pmtiles";

/// The map of streets below the radar map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BaseMap {
    source: Source,
    attribution: String,
    max_zoom: u8,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Source {
    /// Tiles of another service: the template of their addresses, and their origin.
    Tiles { template: String, origin: String },
    /// A `PMTiles` file.
    File(PathBuf),
}

impl Source {
    /// What is configured; `None` for a template that makes no sense.
    fn of(text: &str) -> Option<Self> {
        let Some((scheme, rest)) = text.split_once("://") else { return Some(Self::File(text.into())) };
        let (host, path) = rest.split_once('/')?;
        let origin = format!("{scheme}://{host}");
        let whole = ["{z}", "{x}", "{y}"].iter().all(|part| path.contains(part));
        let plain = path.bytes().all(|b| b.is_ascii_graphic() && !b"\"'<>\\".contains(&b));
        (whole && plain && is_origin(&origin)).then(|| Self::Tiles { template: text.to_owned(), origin })
    }
}

impl BaseMap {
    /// What is configured, checked before; `None` when it is empty.
    #[must_use]
    pub fn of(text: &str, attribution: &str, max_zoom: u8) -> Option<Self> {
        let source = Source::of(text).filter(|_| !text.is_empty())?;
        Some(Self { source, attribution: attribution.to_owned(), max_zoom })
    }

    /// Where the console's page may load from besides its own origin.
    pub(super) fn origin(&self) -> Option<&str> {
        match &self.source {
            Source::Tiles { origin, .. } => Some(origin),
            Source::File(_) => None,
        }
    }
}

/// Is this empty, the template of tiles' addresses, or a `PMTiles` file that can be read?
#[must_use]
pub fn is_base_map(text: &str) -> bool {
    match Source::of(text) {
        _ if text.is_empty() => true,
        Some(Source::File(path)) => begins_as_pmtiles(&path).unwrap_or(false),
        Some(Source::Tiles { .. }) => true,
        None => false,
    }
}

fn begins_as_pmtiles(path: &Path) -> std::io::Result<bool> {
    let mut begin = [0; MAGIC.len()];
    File::open(path)?.read_exact(&mut begin)?;
    Ok(&begin == MAGIC)
}

/// `GET /base-map`
#[utoipa::path(
    get,
    path = "/base-map",
    operation_id = "getBaseMap",
    tag = "console",
    summary = "The map of streets that the console shows below the radar map.",
    description = "",
    responses(
        (status = 200, description = "It, or that there is none.", body = BaseMapAnswer),
    )
)]
pub async fn described(State(app): State<Arc<App>>) -> Response {
    let (kind, url) = match app.base_map.as_ref().map(|base| &base.source) {
        None => ("NONE", None),
        Some(Source::Tiles { template, .. }) => ("TILES", Some(template.clone())),
        Some(Source::File(_)) => ("PMTILES", Some(FILE.to_owned())),
    };
    let base = app.base_map.as_ref();
    fresh(BaseMapAnswer {
        kind,
        url,
        attribution: base.map(|base| base.attribution.clone()).unwrap_or_default(),
        max_zoom: base.map_or(0, |base| base.max_zoom),
    })
}

/// `GET /base-map.pmtiles`, a range of it
#[utoipa::path(
    get,
    path = "/base-map.pmtiles",
    operation_id = "getBaseMapFile",
    tag = "console",
    summary = "A range of the PMTiles file with the map of streets.",
    description = "One range of at most 8 MiB, as `bytes=0-16383`.",
    params(("range" = String, Header, description = "Which bytes.")),
    responses(
        (status = 206, description = "The range.", body = Vec<u8>, content_type = "application/vnd.pmtiles",
            headers(("content-range" = String, description = "Which bytes of how many."))),
        (status = 400, description = "No range, more than one, or a longer one.", body = ErrorAnswer),
        (status = 404, description = "No such file is configured.", body = ErrorAnswer),
        (status = 416, description = "The range lies behind the file's end.", body = ErrorAnswer),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn file(State(app): State<Arc<App>>, peer: Peer, headers: HeaderMap) -> Result<Response, Error> {
    let Some(Source::File(path)) = app.base_map.as_ref().map(|base| base.source.clone()) else {
        return Err(Error::NotFound("no PMTiles file is configured (`http.base_map`)".to_owned()));
    };
    let asked =
        headers.get(header::RANGE).and_then(|range| range.to_str().ok()).unwrap_or_default().to_owned();
    let part = app.limiter.work(peer, move || Part::read(&path, &asked)).await?;
    Ok(part.into_response())
}

/// A part of a file.
struct Part {
    range: RangeInclusive<u64>,
    bytes: Vec<u8>,
    size: u64,
    tag: String,
}

impl Part {
    fn read(path: &Path, asked: &str) -> Result<Self, Error> {
        let broken = |error: std::io::Error| Error::Internal(format!("the base map cannot be read: {error}"));
        let mut file = File::open(path).map_err(broken)?;
        let about = file.metadata().map_err(broken)?;
        let (size, range) = (about.len(), range_of(asked, about.len())?);
        // Who has read a part of another file must notice.
        let changed =
            about.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok()).unwrap_or_default();
        let tag = format!("\"{size:x}-{:x}\"", changed.as_nanos());
        let mut bytes = vec![0; (range.end() - range.start() + 1) as usize];
        file.seek(SeekFrom::Start(*range.start())).map_err(broken)?;
        file.read_exact(&mut bytes).map_err(broken)?;
        Ok(Self { range, bytes, size, tag })
    }
}

/// The one range of a file that is asked for.
fn range_of(asked: &str, size: u64) -> Result<RangeInclusive<u64>, Error> {
    let malformed = || {
        Error::BadRequest(format!("ask for one range of at most {LONGEST_RANGE} bytes, as `bytes=0-16383`"))
    };
    let parsed = parse_range_header(asked).map_err(|_| malformed())?;
    let ranges = parsed.validate(size).map_err(|_| Error::BehindTheEnd { size })?;
    match ranges.as_slice() {
        [range] if range.end() - range.start() < LONGEST_RANGE => Ok(range.clone()),
        _ => Err(malformed()),
    }
}

impl IntoResponse for Part {
    fn into_response(self) -> Response {
        let Self { range, bytes, size, tag } = self;
        let headers = [
            (header::CONTENT_TYPE, "application/vnd.pmtiles".to_owned()),
            (header::CONTENT_RANGE, format!("bytes {}-{}/{size}", range.start(), range.end())),
            (header::ACCEPT_RANGES, "bytes".to_owned()),
            (header::CACHE_CONTROL, "private, max-age=300".to_owned()),
            (header::ETAG, tag),
        ];
        (StatusCode::PARTIAL_CONTENT, headers, bytes).into_response()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{TestSite, bytes_of, json_of};
    use axum::http::Method;

    fn site(base: &str) -> TestSite {
        TestSite::default().with_base_map(BaseMap::of(base, "© somebody", 17))
    }

    #[test]
    fn what_is_no_base_map_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let write = |name: &str, bytes: &[u8]| {
            let path = dir.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            path.to_str().unwrap().to_owned()
        };
        let (sound, other) = (write("a.pmtiles", b"PMTiles\x03..."), write("b.pmtiles", b"PMTiles\x02..."));
        for good in [
            "",
            "https://tiles.example/{z}/{x}/{y}.png?key=a-b",
            "http://10.0.0.1:8081/t/{z}/{y}/{x}",
            &sound,
        ] {
            assert!(is_base_map(good), "{good}");
        }
        for bad in [
            "https://tiles.example",
            "https://tiles.example/{z}/{x}.png",
            "https://{s}.tiles.example/{z}/{x}/{y}.png",
            "https://tiles.example; script-src */{z}/{x}/{y}.png",
            "https://u:p@tiles.example/{z}/{x}/{y}.png",
            "ftp://tiles.example/{z}/{x}/{y}.png",
            "https://tiles.example/{z}/{x}/{y}.png\"",
            "/nowhere/a.pmtiles",
            &other,
        ] {
            assert!(!is_base_map(bad), "{bad}");
        }
    }

    /// Catches: a page that may load from elsewhere although nothing is configured, or from more than what is.
    #[tokio::test]
    async fn the_page_may_load_from_the_origin_of_the_tiles_and_from_no_other() {
        let policy = async |site: &TestSite| {
            let headers = site.get("/").await.headers().clone();
            headers["content-security-policy"].to_str().unwrap().to_owned()
        };
        let none = policy(&TestSite::default()).await;
        assert!(!none.contains("http"), "{none}");
        let file = policy(&site("/srv/town.pmtiles")).await;
        assert_eq!(file, none);
        let tiles = site("https://tiles.example/a/{z}/{x}/{y}.png");
        let allowed = policy(&tiles).await;
        assert_eq!(allowed.matches("https://tiles.example").count(), 2, "{allowed}");
        assert_eq!(allowed.replace(" https://tiles.example", ""), none);
        let told = json_of(tiles.get("/base-map").await).await;
        assert_eq!(told["url"], "https://tiles.example/a/{z}/{x}/{y}.png");
        assert_eq!(
            (&told["kind"], &told["max_zoom"], &told["attribution"]),
            (&"TILES".into(), &17.into(), &"© somebody".into())
        );
        assert_eq!(json_of(TestSite::default().get("/base-map").await).await["kind"], "NONE");
    }

    /// Catches: a range that is off by one, a file that is handed out whole, and a reader that does not notice another file.
    #[tokio::test]
    async fn a_file_is_handed_out_in_ranges() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("town.pmtiles");
        let content: Vec<u8> = (0..100_u8).collect();
        std::fs::write(&path, &content).unwrap();
        let site = site(path.to_str().unwrap());
        let ask = async |range: &str| {
            let headers: &[_] = if range.is_empty() { &[] } else { &[("range", range)] };
            site.send(Method::GET, "/base-map.pmtiles", headers).await
        };
        let tag = ask("bytes=0-0").await.headers()["etag"].clone();
        for (range, told, bytes) in [
            ("bytes=0-9", "bytes 0-9/100", &content[..10]),
            ("bytes=90-", "bytes 90-99/100", &content[90..]),
            ("bytes=95-400", "bytes 95-99/100", &content[95..]),
            ("bytes=-3", "bytes 97-99/100", &content[97..]),
        ] {
            let answer = ask(range).await;
            assert_eq!(
                (answer.status(), &answer.headers()["etag"]),
                (StatusCode::PARTIAL_CONTENT, &tag),
                "{range}"
            );
            assert_eq!(answer.headers()["content-range"], told);
            assert_eq!(bytes_of(answer).await, bytes);
        }
        for (range, status) in [("", 400), ("bytes=a-b", 400), ("bytes=0-1,5-6", 400), ("bytes=100-", 416)] {
            assert_eq!(ask(range).await.status(), status, "{range}");
        }
        File::create(&path).unwrap().set_len(LONGEST_RANGE + 1).unwrap();
        assert_eq!(ask(&format!("bytes=0-{LONGEST_RANGE}")).await.status(), 400);
        let another = ask(&format!("bytes=1-{LONGEST_RANGE}")).await;
        assert_eq!(another.status(), StatusCode::PARTIAL_CONTENT);
        assert_ne!(another.headers()["etag"], tag);
        assert_eq!(TestSite::default().get("/base-map.pmtiles").await.status(), 404);
    }
}
