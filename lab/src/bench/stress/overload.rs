//! An open loop: requests that come at a rate, whether or not those before were answered.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context;
use bytes::Bytes;
use echofix_harness::percentiles::Percentiles;
use echofix_harness::process::ServiceProcess;
use prost::Message;
use serde::Serialize;
use tokio::task::JoinSet;
use tonic::Code;
use tonic::transport::{Channel, Endpoint};

use super::super::BenchPlan;
use super::super::town::BenchTown;
use super::{Subject, raw};
use crate::machine::held_by;

/// Multiples of the capacity.
const MULTIPLES: [f64; 4] = [1.0, 2.0, 5.0, 10.0];
/// Connections over which the requests come.
const CONNECTIONS: usize = 32;
/// An answer after this is worth nothing to a vehicle.
const PATIENCE: Duration = Duration::from_secs(1);
/// Requests that come together: a timer is no finer.
const TICK: Duration = Duration::from_millis(2);
/// Clients that wait for their answers, to find the capacity.
const CLIENTS: usize = 8;

/// What became of the requests at one rate.
#[derive(Debug, Clone, Serialize)]
pub(in super::super) struct Offered {
    /// Of the capacity.
    pub(in super::super) multiple: f64,
    /// Requests sent, a second.
    pub(in super::super) per_s: f64,
    /// Answers in time, a second.
    pub(in super::super) answered_per_s: f64,
    pub(in super::super) answered_ms: Option<Percentiles>,
    /// Requests refused with `RESOURCE_EXHAUSTED`, a second.
    pub(in super::super) refused_per_s: f64,
    pub(in super::super) refused_ms: Option<Percentiles>,
    /// Requests that came to anything else, a second: mostly late.
    pub(in super::super) lost_per_s: f64,
    /// The most memory that the service held, MB.
    pub(in super::super) most_mb: f64,
}

/// Size of a request, the capacity, and what became of multiples of it.
pub(super) async fn measure(
    plan: &BenchPlan,
    subject: &Subject<'_>,
    town: &BenchTown,
) -> anyhow::Result<(f64, f64, Vec<Offered>)> {
    let (_, questions) = town.by_length.last().context("there are no questions")?;
    let requests: Vec<Bytes> = (0..questions.count())
        .map(|index| questions.question(index).request.encode_to_vec().into())
        .collect();
    let request_kb = requests.iter().map(Bytes::len).sum::<usize>() as f64 / 1e3 / requests.len() as f64;
    let (requests, span) = (Arc::new(requests), Duration::from_secs_f64(plan.load_s));
    let service = subject.start().await?;
    closed(&service, &requests, Duration::from_secs(2)).await?;
    let capacity_per_s = closed(&service, &requests, span).await?;
    let mut offered = Vec::new();
    for multiple in MULTIPLES {
        offered.push(open(&service, &requests, (multiple, capacity_per_s), span).await?);
    }
    service.stop().await?;
    Ok((request_kb, capacity_per_s, offered))
}

async fn connected(service: &ServiceProcess) -> anyhow::Result<Channel> {
    Ok(Endpoint::from_shared(service.grpc.clone())?.connect().await?)
}

/// Answers a second when clients wait for them.
async fn closed(service: &ServiceProcess, requests: &Arc<Vec<Bytes>>, span: Duration) -> anyhow::Result<f64> {
    let (mut clients, began) = (JoinSet::new(), Instant::now());
    for client in 0..CLIENTS {
        let (channel, requests) = (connected(service).await?, Arc::clone(requests));
        clients.spawn(async move {
            let mut answered = 0_u64;
            for request in requests.iter().cycle().skip(client) {
                if began.elapsed() > span {
                    break;
                }
                answered += u64::from(raw::ask(channel.clone(), request.clone()).await.is_ok());
            }
            answered
        });
    }
    let answered: u64 = clients.join_all().await.into_iter().sum();
    Ok(answered as f64 / began.elapsed().as_secs_f64())
}

/// Requests at a rate, for a while.
async fn open(
    service: &ServiceProcess,
    requests: &Arc<Vec<Bytes>>,
    (multiple, capacity_per_s): (f64, f64),
    span: Duration,
) -> anyhow::Result<Offered> {
    let mut channels = Vec::new();
    for _ in 0..CONNECTIONS {
        channels.push(connected(service).await?);
    }
    let most_kib = Watched::of(service.pid());
    let (mut calls, began, mut sent) = (JoinSet::new(), Instant::now(), 0_usize);
    let mut ticks = tokio::time::interval(TICK);
    while began.elapsed() < span {
        ticks.tick().await;
        let due = (began.elapsed().as_secs_f64() * multiple * capacity_per_s) as usize;
        while sent < due {
            let (channel, request) =
                (channels[sent % CONNECTIONS].clone(), requests[sent % requests.len()].clone());
            calls.spawn(async move {
                let from = Instant::now();
                let answer = tokio::time::timeout(PATIENCE, raw::ask(channel, request)).await;
                let code = answer
                    .map_or(Code::DeadlineExceeded, |answer| answer.err().map_or(Code::Ok, |e| e.code()));
                (code, from.elapsed().as_secs_f64() * 1e3)
            });
            sent += 1;
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    let outcomes = calls.join_all().await;
    let times = |wanted: Code| outcomes.iter().filter(move |(code, _)| *code == wanted).map(|(_, ms)| *ms);
    let per_s = |count: usize| count as f64 / seconds;
    let (answered, refused) = (times(Code::Ok).count(), times(Code::ResourceExhausted).count());
    Ok(Offered {
        multiple,
        per_s: per_s(sent),
        answered_per_s: per_s(answered),
        answered_ms: Percentiles::of(times(Code::Ok)),
        refused_per_s: per_s(refused),
        refused_ms: Percentiles::of(times(Code::ResourceExhausted)),
        lost_per_s: per_s(sent - answered - refused),
        most_mb: most_kib.end() as f64 * 1.024e-3,
    })
}

/// The most memory that a process held.
struct Watched {
    most_kib: Arc<AtomicU64>,
    over: Arc<AtomicBool>,
}

impl Watched {
    fn of(pid: u32) -> Self {
        let (most_kib, over) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let (most, ended) = (Arc::clone(&most_kib), Arc::clone(&over));
        std::thread::spawn(move || {
            while !ended.load(Ordering::Relaxed) {
                most.fetch_max(held_by(pid).unwrap_or(0), Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(100));
            }
        });
        Self { most_kib, over }
    }

    fn end(self) -> u64 {
        self.over.store(true, Ordering::Relaxed);
        self.most_kib.load(Ordering::Relaxed)
    }
}
