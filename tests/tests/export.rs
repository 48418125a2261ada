//! Spans of calls reach an OpenTelemetry collector, and a collector that is away or slow changes nothing.

#![expect(clippy::unwrap_used, reason = "a test fails by it")]

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use echofix_tests::grpc;
use echofix_tests::service::{Service, Setup};
use echofix_tests::world::World;
use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{
    TraceService, TraceServiceServer,
};
use opentelemetry_proto::tonic::collector::trace::v1::{
    ExportTraceServiceRequest, ExportTraceServiceResponse,
};
use opentelemetry_proto::tonic::trace::v1::Span;
use opentelemetry_proto::tonic::trace::v1::span::SpanKind;
use tokio::net::TcpListener;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status};

/// Takes what it is sent.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<ExportTraceServiceRequest>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        self.0.lock().unwrap().push(request.into_inner());
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

impl Collector {
    async fn start() -> (Self, String) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let collector = Self::default();
        let service = TraceServiceServer::new(collector.clone());
        let incoming = TcpListenerStream::new(listener);
        tokio::spawn(tonic::transport::Server::builder().add_service(service).serve_with_incoming(incoming));
        (collector, address)
    }

    fn spans(&self) -> Vec<Span> {
        let requests = self.0.lock().unwrap();
        let scopes =
            requests.iter().flat_map(|request| &request.resource_spans).flat_map(|of| &of.scope_spans);
        scopes.flat_map(|scope| scope.spans.clone()).collect()
    }

    /// The texts of the resource's attributes.
    fn resource(&self) -> String {
        format!("{:?}", self.0.lock().unwrap()[0].resource_spans[0].resource)
    }
}

const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";
const PARENT: &str = "b7ad6b7169203331";

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |text, byte| format!("{text}{byte:02x}"))
}

/// Catches: spans that are not sent, begin a trace of their own instead of the caller's, lack their parts or how they ended, are
/// lost at the end, or tell where somebody is.
#[tokio::test(flavor = "multi_thread")]
async fn a_call_is_part_of_its_callers_trace() {
    let (collector, address) = Collector::start().await;
    // The name of the environment, which every collector's manual has.
    let variables = vec![("OTEL_EXPORTER_OTLP_ENDPOINT", address)];
    let service = Service::start_as(Setup { variables, ..Setup::default() });
    let mut world = World::mapped_with(service).await;
    let case = world.questions(120.0, 5.0).into_iter().next().unwrap();
    let mut request = Request::new(case.request.clone());
    request.metadata_mut().insert("traceparent", format!("00-{TRACE}-{PARENT}-01").parse().unwrap());
    grpc::localizing(&world.service).await.localize(request).await.unwrap();
    let page = format!("{}/api/v1/tiles/at?lat=1&lon=2", world.service.http);
    let page = ureq::get(&page).header("traceparent", format!("00-{TRACE}-{PARENT}-01"));
    page.config().http_status_as_error(false).build().call().unwrap();
    world.service.ask_to_end();
    assert_eq!(world.service.ended().code(), Some(0));

    let spans = collector.spans();
    let named = |name: &str| spans.iter().filter(|span| span.name == name).collect::<Vec<_>>();
    let ours = |span: &&Span| hex(&span.trace_id) == TRACE;
    let call = named("echofix.v1.LocalizationService/Localize").into_iter().find(ours).unwrap();
    assert_eq!((hex(&call.parent_span_id).as_str(), call.kind()), (PARENT, SpanKind::Server));
    let said = format!("{:?}", call.attributes);
    assert!(said.contains("\"OK\"") && said.contains("echofix.role"), "{said}");
    let parts: BTreeSet<_> = spans
        .iter()
        .filter(|span| span.parent_span_id == call.span_id)
        .inspect(|span| assert_eq!(hex(&span.trace_id), TRACE))
        .map(|span| span.name.as_str())
        .collect();
    assert_eq!(parts, BTreeSet::from(["align", "map", "queue", "relocalize"]));
    let upload = named("echofix.v1.MappingService/Upload")[0];
    assert!(named("journal").iter().any(|part| part.parent_span_id == upload.span_id));
    assert!(!named("fold").is_empty());
    let asked = named("api/v1/tiles/at").into_iter().find(ours).unwrap();
    assert_eq!(hex(&asked.parent_span_id), PARENT);
    let all = format!("{spans:?}");
    assert!(!all.contains("lat=") && !all.contains("latitude") && !all.contains("contributor"), "{all}");
    let resource = collector.resource();
    assert!(
        ["\"echofix\"", "service.version", "service.instance.id"].iter().all(|part| resource.contains(part)),
        "{resource}"
    );
}

/// Catches: a service that waits for a collector which takes connections and answers nothing, when it answers or ends, or does not
/// start without one.
#[tokio::test(flavor = "multi_thread")]
async fn a_collector_that_hangs_keeps_nobody_waiting() {
    let silent = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = silent.local_addr().unwrap();
    for endpoint in [format!("http://{address}"), "http://127.0.0.1:9".to_owned()] {
        let setting = format!("trace.otlp_endpoint={endpoint}");
        let mut service = Service::start_with(&[&setting]);
        for _ in 0..20 {
            ureq::get(format!("{}/readyz", service.http)).call().unwrap();
        }
        service.ask_to_end();
        let ended = tokio::task::spawn_blocking(move || service.ended());
        // Far more than it should take, since machines are loaded; a hanging export would take for ever.
        let ended = tokio::time::timeout(Duration::from_mins(1), ended).await.unwrap().unwrap();
        assert_eq!(ended.code(), Some(0));
    }
}
