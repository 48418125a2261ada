//! The description of these routes.

use axum::http::header;
use axum::response::IntoResponse;

/// Written by hand; a test holds it against the list of routes.
const DOCUMENT: &str = include_str!("openapi.json");

/// `GET /openapi.json`
pub async fn document() -> impl IntoResponse {
    ([(header::CONTENT_TYPE, "application/json"), (header::CACHE_CONTROL, "no-cache")], DOCUMENT)
}

#[cfg(test)]
mod tests {
    use super::DOCUMENT;
    use crate::feed::{FixEvent, UploadEvent};
    use crate::http::testing::{TestSite, a_fix, an_upload, austin, json_of};
    use serde_json::{Value, json};
    use std::collections::BTreeSet;

    fn document() -> Value {
        serde_json::from_str(DOCUMENT).unwrap()
    }

    fn keys(value: &Value) -> BTreeSet<String> {
        value.as_object().unwrap().keys().cloned().collect()
    }

    #[test]
    fn every_route_is_described_and_every_description_is_a_route() {
        // The router has no parameters within a segment: the suffix belongs to the description.
        let described: BTreeSet<_> = keys(&document()["paths"])
            .into_iter()
            .map(|path| path.trim_end_matches(".json").trim_end_matches(".png").to_owned())
            .collect();
        let served: BTreeSet<_> =
            crate::http::paths().into_iter().map(|path| path.trim_end_matches(".json").to_owned()).collect();
        assert_eq!(described, served);
    }

    #[test]
    fn every_parameter_of_a_path_is_described() {
        for (path, item) in document()["paths"].as_object().unwrap() {
            let described: BTreeSet<_> = item["get"]["parameters"]
                .as_array()
                .into_iter()
                .flatten()
                .filter(|p| p["in"] == "path")
                .map(|p| p["name"].as_str().unwrap().to_owned())
                .collect();
            let named: BTreeSet<_> =
                path.split('{').skip(1).map(|p| p.split('}').next().unwrap().to_owned()).collect();
            assert_eq!(described, named, "{path}");
        }
    }

    #[tokio::test]
    async fn answers_have_the_described_properties() {
        let site = TestSite::with_tiles(&[(austin(), &[(0, 1)])]);
        let schemas = &document()["components"]["schemas"];
        let described = |name: &str| keys(&schemas[name]["properties"]);
        for (path, schema) in [
            ("/api/v1/map".to_owned(), "Map"),
            (format!("/api/v1/tiles/{}", austin()), "Tile"),
            (format!("/api/v1/tiles/{}/localizability", austin()), "Localizability"),
            ("/tiles/age.json".to_owned(), "TileJson"),
            ("/readyz".to_owned(), "Readiness"),
            ("/nowhere".to_owned(), "Error"),
        ] {
            let body = json_of(site.get(&path).await).await;
            assert_eq!(keys(&body), described(schema), "{path}");
        }
        let expected = format!("/api/v1/tiles/{}/localizability", austin());
        let body = json_of(site.get(&expected).await).await;
        assert_eq!(keys(&body["places"][0]), described("ExpectedFix"));
        let plain = |event: Result<Value, _>| -> Value {
            let e: Result<Value, serde_json::Error> = event;
            e.unwrap()
        };
        let (fix, upload): (FixEvent, UploadEvent) = (a_fix(), an_upload());
        assert_eq!(keys(&plain(serde_json::to_value(fix))), described("Fix"));
        assert_eq!(keys(&plain(serde_json::to_value(upload))), described("Upload"));
    }

    #[tokio::test]
    async fn it_is_served() {
        let body = json_of(TestSite::default().get("/openapi.json").await).await;
        assert_eq!(body["openapi"], json!("3.1.0"));
        assert_eq!(body["info"]["version"], env!("CARGO_PKG_VERSION"));
    }
}
