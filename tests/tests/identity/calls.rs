//! Everything that can be called, and who may: written down here a second time, by hand, and held against what the service
//! itself lists.

use std::collections::BTreeSet;

use prost::Message;
use prost_types::FileDescriptorProto;
use tonic_reflection::pb::v1::ServerReflectionRequest;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;

use super::site::Site;

pub const ROLES: [&str; 7] = ["vehicle", "mapper", "gateway", "viewer", "operator", "admin", "replica"];

const ALL: &str = "nobody vehicle mapper gateway viewer operator admin replica";
const KNOWN: &str = "vehicle mapper gateway viewer operator admin replica";
const VEHICLES: &str = "vehicle mapper gateway admin replica";
const MAPPERS: &str = "mapper gateway admin";
const VIEWERS: &str = "viewer operator admin replica";
const OPERATORS: &str = "operator admin";

/// A call as it is made: a gRPC method, or a method of HTTP and a route.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Call {
    /// Empty for gRPC.
    pub method: String,
    pub path: String,
}

impl Call {
    pub fn rpc(path: &str) -> Self {
        Self { method: String::new(), path: path.to_owned() }
    }

    pub fn http(method: &str, path: &str) -> Self {
        Self { method: method.to_owned(), path: path.to_owned() }
    }
}

/// Call, and the roles that may.
const EXPECTED: &[(&str, &str, &str)] = &[
    ("", "/echofix.v1.LocalizationService/Localize", VEHICLES),
    ("", "/echofix.v1.LocalizationService/LocalizeStream", VEHICLES),
    ("", "/echofix.v1.MapService/GetTiles", VEHICLES),
    ("", "/echofix.v1.MapService/GetCoverage", VEHICLES),
    ("", "/echofix.v1.MappingService/Upload", MAPPERS),
    ("", "/grpc.health.v1.Health/Check", ALL),
    ("", "/grpc.health.v1.Health/Watch", ALL),
    ("", "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo", KNOWN),
    ("GET", "/healthz", ALL),
    ("GET", "/readyz", ALL),
    ("GET", "/metrics", VIEWERS),
    ("GET", "/openapi.json", ALL),
    ("GET", "/", ALL),
    ("GET", "/assets/{name}", ALL),
    ("GET", "/base-map", VIEWERS),
    ("GET", "/base-map.pmtiles", VIEWERS),
    ("GET", "/session", KNOWN),
    ("POST", "/session", ALL),
    ("DELETE", "/session", ALL),
    ("GET", "/session/ways", ALL),
    ("GET", "/session/oidc", ALL),
    ("GET", "/session/callback", ALL),
    ("GET", "/tiles/{layer}", VIEWERS),
    ("GET", "/tiles/{layer}/{z}/{x}/{y}", VIEWERS),
    ("GET", "/api/v1/map", VIEWERS),
    ("GET", "/api/v1/map/history", VIEWERS),
    ("GET", "/api/v1/map/quarantine", VIEWERS),
    ("GET", "/api/v1/map/export", VIEWERS),
    ("GET", "/api/v1/tiles/at", VIEWERS),
    ("GET", "/api/v1/tiles/{epsg}/{x}/{y}", VIEWERS),
    ("GET", "/api/v1/tiles/{epsg}/{x}/{y}/localizability", VIEWERS),
    ("GET", "/api/v1/tiles/{epsg}/{x}/{y}/cells", VIEWERS),
    ("GET", "/api/v1/cells/at", VIEWERS),
    ("GET", "/api/v1/events", VIEWERS),
    ("GET", "/api/v1/uploads", VIEWERS),
    ("GET", "/api/v1/fixes", OPERATORS),
    ("GET", "/api/v1/contributors", OPERATORS),
    ("GET", "/api/v1/contributors/{hash}/uploads", OPERATORS),
    ("GET", "/api/v1/uploads/{id}", OPERATORS),
    ("GET", "/api/v1/map/diff", OPERATORS),
    ("GET", "/api/v1/map/verify", OPERATORS),
    ("POST", "/api/v1/map/verify", OPERATORS),
    ("GET", "/api/v1/map/backup", OPERATORS),
    ("POST", "/api/v1/map/rollback", OPERATORS),
    ("POST", "/api/v1/map/revoke", OPERATORS),
    ("POST", "/api/v1/map/undo", OPERATORS),
    ("POST", "/api/v1/map/compact", OPERATORS),
    ("POST", "/api/v1/map/settle", OPERATORS),
    ("POST", "/api/v1/map/import", OPERATORS),
];

/// Whether a role, or `nobody`, may make a call.
pub fn may(role: &str, call: &Call) -> bool {
    let entry = EXPECTED.iter().find(|(method, path, _)| (*method, *path) == (&call.method, &call.path));
    let (_, _, roles) = entry.unwrap_or_else(|| panic!("{call:?} is not listed in this test"));
    roles.split(' ').any(|listed| listed == role)
}

/// Every call: what the service lists, which must be what is expected.
pub async fn all(site: &Site) -> Vec<Call> {
    let mut served: BTreeSet<Call> = rpcs(site).await.into_iter().collect();
    // A route's methods are those of the service's table: any other is answered 405, whatever the router has.
    for path in echofix_server::http::paths() {
        let methods: Vec<_> = echofix_server::identity::access::methods(path).collect();
        assert!(!methods.is_empty(), "{path} is served and in no table");
        served.extend(methods.into_iter().map(|method| Call::http(method, path)));
    }
    let expected: BTreeSet<_> = EXPECTED
        .iter()
        .map(|(method, path, _)| Call { method: (*method).to_owned(), path: (*path).to_owned() })
        .collect();
    let (new, gone): (Vec<_>, Vec<_>) =
        (served.difference(&expected).collect(), expected.difference(&served).collect());
    assert!(new.is_empty() && gone.is_empty(), "not listed here: {new:?}; not served: {gone:?}");
    served.into_iter().collect()
}

/// All RPCs, as the service's reflection describes them.
async fn rpcs(site: &Site) -> Vec<Call> {
    let mut client = ServerReflectionClient::new(site.certified("admin").channel());
    let mut ask = async |message| {
        let request = ServerReflectionRequest { host: String::new(), message_request: Some(message) };
        let answers = client.server_reflection_info(tokio_stream::iter([request])).await;
        answers.unwrap().into_inner().message().await.unwrap().unwrap().message_response.unwrap()
    };
    let MessageResponse::ListServicesResponse(list) = ask(MessageRequest::ListServices(String::new())).await
    else {
        panic!("no list of services");
    };
    let mut calls = Vec::new();
    for service in list.service {
        let described = ask(MessageRequest::FileContainingSymbol(service.name.clone())).await;
        let MessageResponse::FileDescriptorResponse(files) = described else { panic!("{}", service.name) };
        for file in files.file_descriptor_proto {
            let file = FileDescriptorProto::decode(&file[..]).unwrap();
            for described in &file.service {
                let name = format!("{}.{}", file.package(), described.name());
                if name == service.name {
                    calls
                        .extend(described.method.iter().map(|m| Call::rpc(&format!("/{name}/{}", m.name()))));
                }
            }
        }
    }
    calls
}
