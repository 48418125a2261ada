//! The map on the vehicle: what a cache is sent, over restarts, damage, a rollback and a kill; and large tiles.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use echofix_client::service;
use echofix_client::tiles::{Synced, TileCache, TileCacheLimits, Want};
use echofix_core::evidence::Cell;
use echofix_core::geo::{LatLon, TileId, Zone};
use echofix_core::tile::{self, Grain, Tile};
use echofix_tests::command::echofix;
use echofix_tests::service::Service;
use echofix_tests::tiles::{self, EVERYWHERE, Tiles};
use echofix_tests::wiretap::Wiretap;
use echofix_tests::{binary, crowd, grpc, mapping, town, until_blocking};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use uuid::Uuid;

fn open(dir: &Path) -> TileCache {
    TileCache::open(dir, TileCacheLimits::default()).expect("the cache can be opened")
}

fn endpoint(url: &str) -> service::ServiceEndpoint {
    service::ServiceAddress::at(url).endpoint().expect("the address is one")
}

async fn sync(cache: &TileCache, tap: &Wiretap) -> Synced {
    cache.sync(&endpoint(&tap.grpc), &Want::Area(EVERYWHERE)).await.expect("the map can be read")
}

/// Asserts that a cache holds just the map that a service serves.
fn assert_is(cache: &TileCache, map: &Tiles) {
    let versions: Vec<_> = map.iter().map(|(id, (version, _))| (*id, *version)).collect();
    assert_eq!(cache.versions(), versions);
    for (id, (version, encoded)) in map {
        let tile = tile::decode(encoded).expect("a served tile is sound");
        assert_eq!(cache.tile(*id).expect("the disk is sound"), Some((*version, tile)), "tile {id}");
    }
}

/// The file of a tile.
fn file(dir: &Path, id: TileId, version: u64) -> PathBuf {
    dir.join(id.zone.epsg().to_string()).join(format!("{}_{}_{version}.tile", id.x, id.y))
}

/// Catches a cache that is sent what it has, keeps what is no longer true, does not notice damage, or forgets over a
/// restart: breaks, for one, when versions are not sent, absent tiles stay, or damaged files keep their version.
#[tokio::test(flavor = "multi_thread")]
async fn a_cache_is_sent_what_changed_and_no_more() {
    let seed = town::seed();
    let city = town::town(seed);
    let uploads = mapping::uploads(&town::wander(&city, 0, "mapper", seed, 400.0));
    let (last, first) = uploads.split_last().expect("the drive makes uploads");
    let service = Service::start();
    let mut sender = grpc::mapping(&service).await;
    for upload in first {
        mapping::send(&mut sender, upload.parts()).await.expect("the upload counts");
    }
    let epoch = mapping::folded(&service).await;
    let (dir, tap) = (service.scratch().join("tiles"), Wiretap::on(&service).await);

    let cache = open(&dir);
    let all = sync(&cache, &tap).await;
    let map = tiles::all(&service).await;
    let whole = tap.taken();
    assert_eq!((all.fetched as usize, all.unchanged, all.epoch), (map.len(), 0, epoch));
    assert!(all.bytes == cache.bytes() && whole >= all.bytes, "{whole} bytes on the wire, {all:?}");
    assert_is(&cache, &map);

    let nothing = Synced { fetched: 0, bytes: 0, unchanged: all.fetched, ..all };
    assert_eq!(sync(&cache, &tap).await, nothing);
    let unchanged = tap.taken();
    let most = 1_000 + 32 * map.len() as u64;
    eprintln!("{} tiles: {whole} bytes at first, {unchanged} when nothing changed", map.len());
    assert!(unchanged < most && unchanged * 20 < whole, "{unchanged} of {whole} bytes, nothing changed");

    let answer = mapping::send(&mut sender, last.parts()).await.expect("the upload counts");
    mapping::folded(&service).await;
    let changed = sync(&cache, &tap).await;
    assert_eq!(changed.fetched as usize, answer.tiles.len());
    eprintln!("{} tiles changed: {} bytes", changed.fetched, tap.taken());
    let newer = tiles::all(&service).await;
    assert_is(&cache, &newer);

    drop(cache);
    let cache = open(&dir);
    assert_eq!(sync(&cache, &tap).await.fetched, 0);

    let (id, (version, _)) = newer.first_key_value().expect("the map is not empty");
    let damaged = file(&dir, *id, *version);
    let mut bytes = fs::read(&damaged).expect("a tile has its file");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&damaged, bytes).expect("the file can be written");
    assert_eq!(cache.tile(*id).expect("the disk is sound"), None);
    assert_eq!(sync(&cache, &tap).await.fetched, 1);
    assert_is(&cache, &newer);

    let http = ["--http", &service.http, "--json"];
    echofix(["map", "rollback", "--yes", &epoch.to_string()].iter().chain(&http)).json();
    mapping::folded(&service).await;
    let back = sync(&cache, &tap).await;
    let served = tiles::all(&service).await;
    let moved = served.iter().filter(|(id, (version, _))| newer.get(id).is_some_and(|(v, _)| v != version));
    assert_eq!((back.fetched as usize, back.removed as usize), (moved.count(), newer.len() - served.len()));
    assert!(back.fetched > 0, "{back:?}");
    assert_is(&cache, &served);
    let contents = |map: &Tiles| map.iter().map(|(id, (_, bytes))| (*id, bytes.clone())).collect::<Vec<_>>();
    assert_eq!(contents(&served), contents(&map), "it is the map before the upload");

    echofix(["map", "rollback", "--yes", "0"].iter().chain(&http)).json();
    mapping::folded(&service).await;
    let nothing = sync(&cache, &tap).await;
    assert_eq!((nothing.removed as usize, cache.versions().len(), cache.bytes()), (served.len(), 0, 0));
}

/// Catches layers that are sent whether or not they changed, are no layers of what is served, or stay tiles where a folder is
/// asked for the other form.
#[tokio::test(flavor = "multi_thread")]
async fn a_cache_of_layers_follows_the_map_and_may_change_its_form() {
    let seed = town::seed();
    let uploads = mapping::uploads(&town::wander(&town::town(seed), 0, "mapper", seed, 300.0));
    let (last, first) = uploads.split_last().expect("the drive makes uploads");
    let service = Service::start();
    let mut sender = grpc::mapping(&service).await;
    for upload in first {
        mapping::send(&mut sender, upload.parts()).await.expect("the upload counts");
    }
    mapping::folded(&service).await;
    let (cache, want) = (open(&service.scratch().join("layers")), Want::Area(EVERYWHERE));
    let endpoint = endpoint(&service.grpc);
    let layers = cache.sync_layer(&endpoint, &want).await.expect("the map can be read");
    assert_layers(&cache, &tiles::all(&service).await);
    assert_eq!(cache.sync_layer(&endpoint, &want).await.expect("it can").fetched, 0, "nothing changed");

    let answer = mapping::send(&mut sender, last.parts()).await.expect("the upload counts");
    mapping::folded(&service).await;
    let changed = cache.sync_layer(&endpoint, &want).await.expect("the map can be read");
    assert_eq!(changed.fetched as usize, answer.tiles.len());
    let map = tiles::all(&service).await;
    assert_layers(&cache, &map);

    let whole = cache.sync(&endpoint, &want).await.expect("the map can be read");
    assert_eq!(whole.fetched as usize, map.len());
    assert!(layers.bytes * 4 < whole.bytes, "{layers:?} of {whole:?}");
    assert_is(&cache, &map);
    let back = cache.sync_layer(&endpoint, &want).await.expect("the map can be read");
    assert_eq!(back.fetched as usize, map.len());
    assert_layers(&cache, &map);
    echofix(["map", "rollback", "--yes", "0", "--http", &service.http, "--json"]).json();
    mapping::folded(&service).await;
    // In either form what the map no longer holds goes.
    let gone = cache.sync(&endpoint, &want).await.expect("the map can be read");
    assert_eq!((gone.removed as usize, cache.bytes()), (map.len(), 0));
}

/// Asserts that a cache holds the layers of just the map that a service serves.
fn assert_layers(cache: &TileCache, map: &Tiles) {
    let versions: Vec<_> = map.iter().map(|(id, (version, _))| (*id, *version)).collect();
    assert_eq!(cache.versions(), versions);
    for (id, (version, encoded)) in map {
        let layer = tile::encode_layer(&tile::decode(encoded).expect("it is sound"), &Grain::VEHICLE);
        let layer = tile::decode_layer(&layer).expect("a layer can be read");
        assert_eq!(cache.tile(*id).expect("the disk is sound"), Some((*version, layer)), "tile {id}");
    }
}

/// Catches a cache that keeps what a map showed before its backup was restored: breaks when versions go on where the
/// backup ended, for then the same ones name other tiles.
#[tokio::test(flavor = "multi_thread")]
async fn a_cache_is_right_again_after_a_backup_was_restored() {
    let mut service = Service::start_with(&["mapping.vet=false"]);
    let zone = Zone::from_epsg(32614).expect("a zone of UTM");
    let corner = TileId { zone, x: 12_000, y: 65_000 }.origin();
    let upload_one = async |service: &Service, number: u64| {
        let wall = (0..50).map(|i| corner.moved(1.0, 0.0).moved(number as f64, 0.1 * f64::from(i)));
        let (id, contribution) = (Uuid::from_u64_pair(1, number), crowd::hits(zone, wall, 2));
        let parts = crowd::upload(id, "mapper", 1_767_225_600_000_000, &contribution);
        mapping::send(&mut grpc::mapping(service).await, &parts).await.expect("the upload counts");
        mapping::folded(service).await
    };
    let folder = service.scratch();
    let archive = folder.join("all.tar");
    let cache = open(&folder.join("tiles"));
    upload_one(&service, 1).await;
    echofix(["map", "backup", archive.to_str().expect("a path"), "--http", &service.http, "--json"]).json();
    let lost = upload_one(&service, 2).await;
    assert_eq!(sync(&cache, &Wiretap::on(&service).await).await.fetched, 1);

    service.kill();
    fs::remove_dir_all(service.data_dir()).expect("it can be removed");
    fs::create_dir(service.data_dir()).expect("a folder can be made");
    let unpacked = Command::new("tar").arg("xf").arg(&archive).arg("-C").arg(service.data_dir()).status();
    assert!(unpacked.expect("tar can be run").success());
    service.start_again();
    assert_eq!(upload_one(&service, 3).await, lost, "the epochs count on from the backup");
    assert_eq!(sync(&cache, &Wiretap::on(&service).await).await.fetched, 1);
    assert_is(&cache, &tiles::all(&service).await);
    assert_eq!(sync(&cache, &Wiretap::on(&service).await).await.fetched, 0);
}

/// Catches a route that lacks tiles of the area around it.
#[tokio::test(flavor = "multi_thread")]
async fn a_route_is_enough_to_follow() {
    let seed = town::seed();
    let drive = town::wander(&town::town(seed), 0, "mapper", seed, 300.0);
    let service = Service::start();
    mapping::contribute(&service, &drive).await;
    let cache = open(&service.scratch().join("tiles"));
    let route: Vec<LatLon> = drive.truth.iter().step_by(40).map(|pose| pose.at).collect();
    let want = Want::along(&route, 150.0).expect("the route is on the map");
    cache.sync(&endpoint(&service.grpc), &want).await.expect("the map can be read");
    assert_is(&cache, &tiles::all(&service).await);
    let again = cache.sync(&endpoint(&service.grpc), &want).await.expect("the map can be read");
    assert_eq!((again.fetched, again.unchanged as usize), (0, cache.versions().len()));
}

/// A region's file with tiles in which every cell is known, and no two alike.
fn dense_region(tiles: i32, seed: u64) -> Vec<u8> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut file = b"EFX\x01".to_vec();
    file.extend([7; 16]);
    file.extend([0; 40]);
    file.extend((tiles as u64).to_le_bytes());
    for x in 0..tiles {
        let mut cell = |index| {
            let (hits, first_day) = (random.random_range(1..60_000), random.random_range(20_000..20_400));
            let offset_sum = [0; 2].map(|_: u32| random.random_range(0..hits * 256));
            let (passes, last_day) = (random.random_range(1..200), first_day + random.random_range(0..100));
            let contributors = random.random_range(1..100);
            let presence = random.random_range(1_000..30_000);
            (index, Cell { hits, passes, contributors, presence, first_day, last_day, offset_sum })
        };
        let cells = (0..tile::CELLS).map(&mut cell).collect();
        let encoded = tile::encode(&Tile::from_cells(cells).expect("the cells are in order"));
        assert!(encoded.len() > 3 << 20, "{} bytes", encoded.len());
        file.extend(32_614_u32.to_le_bytes());
        file.extend((12_131 + x).to_le_bytes());
        file.extend(65_407_i32.to_le_bytes());
        file.extend(1_u64.to_le_bytes());
        file.extend((encoded.len() as u32).to_le_bytes());
        file.extend(encoded);
    }
    file.extend(crc32c::crc32c(&file).to_le_bytes());
    file
}

/// A service that holds such tiles.
fn dense(tiles: i32) -> Service {
    let service = Service::start();
    let region = service.scratch().join("dense.efx");
    fs::write(&region, dense_region(tiles, town::seed())).expect("the file can be written");
    let region = region.to_str().expect("the path is Unicode");
    echofix(["map", "import", region, "--http", &service.http, "--json"]).json();
    service
}

/// Catches tiles that are sent in one message, which gRPC's usual limit of 4 MiB would not let pass, and pieces that are
/// put together wrongly. The limit is the one that both clients here have.
#[tokio::test(flavor = "multi_thread")]
async fn a_tile_of_megabytes_comes_in_pieces() {
    let service = dense(2);
    mapping::folded(&service).await;
    let map = tiles::all(&service).await;
    let sizes: Vec<usize> = map.values().map(|(_, encoded)| encoded.len()).collect();
    assert!(sizes.len() == 2 && sizes.iter().all(|bytes| *bytes > 3 << 20), "{sizes:?}");
    let cache = open(&service.scratch().join("tiles"));
    let done = cache.sync(&endpoint(&service.grpc), &Want::Area(EVERYWHERE)).await.expect("they come");
    assert_eq!((done.fetched, done.bytes), (2, sizes.iter().sum::<usize>() as u64));
    assert_is(&cache, &map);

    let small =
        TileCache::open(service.scratch().join("small"), TileCacheLimits { max_bytes: done.bytes - 1 });
    let small = small.expect("the cache can be opened");
    let error = small.sync(&endpoint(&service.grpc), &Want::Area(EVERYWHERE)).await.expect_err("too much");
    assert!(error.to_string().contains("raise the limit"), "{error}");
    let zone = Zone::from_epsg(32_614).expect("a zone");
    assert!(small.tile(TileId { zone, x: 12_131, y: 65_407 }).expect("the disk is sound").is_some());
}

/// Catches a download that leaves an unsound folder when it is killed (kill -9): one that writes tiles in place, or
/// trusts what it finds.
#[tokio::test(flavor = "multi_thread")]
async fn a_killed_download_goes_on_where_it_was() {
    let service = dense(6);
    mapping::folded(&service).await;
    let dir = service.scratch().join("tiles");
    let words = ["tiles", "sync", dir.to_str().expect("Unicode"), "--server", &service.grpc, "--json"];
    let mut download = Command::new(binary::echofix())
        .args(words)
        .stdout(Stdio::null())
        .spawn()
        .expect("echofix can be run");
    until_blocking("a tile has come", Duration::from_mins(1), || {
        let files = fs::read_dir(dir.join("32614")).into_iter().flatten().flatten();
        files.into_iter().any(|file| file.path().extension().is_some_and(|e| e == "tile")).then_some(())
    });
    // It may have come to its end already; that is sound as well.
    let _ = download.kill();
    download.wait().expect("it is ours to wait for");
    let rest = echofix(words).json();
    assert_eq!(rest["fetched"].as_u64().unwrap() + rest["unchanged"].as_u64().unwrap(), 6, "{rest}");
    assert!(rest["unchanged"].as_u64() > Some(0), "{rest}");
    assert_eq!(rest["folder"]["tiles"], 6);
    eprintln!("killed after {} of 6 tiles", rest["unchanged"]);
    assert_is(&open(&dir), &tiles::all(&service).await);
}
