//! What a request costs beside its alignment, in time and in allocations:
//! `cargo bench -p echofix-tests --bench request`.
//!
//! One thread, a 5 s batch of three radars of the default town; compare ratios within one run.

use std::sync::LazyLock;

use divan::counter::ItemsCount;
use divan::{AllocProfiler, Bencher};
use echofix_core::batch::Batch;
use echofix_core::gate::Gate;
use echofix_proto::v1::LocalizeRequest;
use echofix_server::grpc::decode;
use echofix_sim::{City, CityParams, DriveParams, Route, simulate};
use echofix_tests::asking::requests;
use prost::Message;

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

fn main() {
    divan::main();
}

/// The request in the middle of a drive.
static REQUEST: LazyLock<LocalizeRequest> = LazyLock::new(|| {
    let city = City::generate(&CityParams::default()).expect("the default town can be made");
    let way = Route::wander(&city, 1, 300.0);
    let drive = simulate(&city.on_day(3), &way, &DriveParams::default()).expect("the drive can be made");
    let asked = requests(&drive, 5.0, 1);
    asked[asked.len() / 2].request.clone()
});

fn detections() -> ItemsCount {
    let scans = REQUEST.batch.as_ref().and_then(|batch| batch.scans.as_ref());
    ItemsCount::new(scans.map_or(0, |scans| scans.range_m.len()))
}

/// Bytes to columns, by the generated code.
#[divan::bench]
fn protobuf(bencher: Bencher) {
    let bytes = REQUEST.encode_to_vec();
    bencher
        .counter(detections())
        .bench(|| LocalizeRequest::decode(&bytes[..]).expect("the request was encoded as one"));
}

/// Columns to a batch that is checked.
#[divan::bench]
fn checked(bencher: Bencher) {
    bencher
        .counter(detections())
        .with_inputs(|| REQUEST.batch.clone())
        .bench_values(|batch| decode::batch(batch, "batch").expect("the batch is sound"));
}

/// A checked batch to points in the newest frame.
#[divan::bench]
fn organised(bencher: Bencher) {
    let batch = decode::batch(REQUEST.batch.clone(), "batch").expect("the batch is sound");
    let (gate, time_us) = (Gate::default(), batch.reference_time_us);
    bencher.counter(detections()).bench(|| {
        Batch::organise(batch.scans.iter(), &batch.mounts, &batch.odometry, time_us, &gate)
            .expect("the odometry covers the batch")
    });
}
