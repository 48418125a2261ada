//! The requests of an S3-compatible store.

use std::fmt::Display;
use std::future::Future;
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::path::Path;
use object_store::{
    ClientOptions, GetOptions, GetRange, ObjectStore, ObjectStoreExt, PutMode, PutOptions, RetryConfig,
};
use tokio::runtime::Runtime;

use super::bucket::{Bucket, Created, Failure, Listed};
use crate::store::api::{Error, io_error};

/// Until a request has its answer, and what it carries may take besides: a compacted map takes longer than a header.
const TIMEOUT: Duration = Duration::from_secs(20);
const PER_BYTE: Duration = Duration::from_micros(1);
const CONNECT: Duration = Duration::from_secs(3);

/// A bucket of an object store, or a folder of one.
pub(in crate::store) struct Remote {
    store: Arc<dyn ObjectStore>,
    prefix: String,
    shown: String,
    /// `Some` until it is dropped.
    runtime: Option<Runtime>,
}

impl Remote {
    /// The bucket of `s3://bucket/prefix`, with credentials, region and endpoint from the environment, as `AWS_*` has them.
    ///
    /// # Errors
    /// When the URL is none of these, or the environment does not do.
    pub(in crate::store) fn s3(url: &str) -> Result<Self, Error> {
        let unusable = |reason: &dyn Display| Error::Unusable(format!("store.url {url:?}: {reason}"));
        let rest = url.strip_prefix("s3://").ok_or_else(|| unusable(&"it does not begin with s3://"))?;
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        if bucket.is_empty() {
            return Err(unusable(&"it names no bucket; write s3://bucket/prefix"));
        }
        // Another part of the process may have chosen one before: the first counts.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let endpoint_is_plain = ["AWS_ENDPOINT_URL", "AWS_ENDPOINT", "AWS_ENDPOINT_URL_S3"]
            .iter()
            .any(|name| std::env::var(name).is_ok_and(|endpoint| endpoint.starts_with("http://")));
        let options = ClientOptions::new()
            .with_timeout_disabled()
            .with_connect_timeout(CONNECT)
            .with_allow_http(endpoint_is_plain || std::env::var("AWS_ALLOW_HTTP").is_ok_and(|v| v == "true"));
        // What is tried again, and what its outcome was, is decided here: the library cannot tell its first success from
        // another's.
        let retry = RetryConfig { max_retries: 0, ..RetryConfig::default() };
        let built = AmazonS3Builder::from_env()
            .with_bucket_name(bucket)
            .with_client_options(options)
            .with_retry(retry)
            .build();
        let store = built.map_err(|error| unusable(&error))?;
        Self::over(Arc::new(store), prefix.trim_matches('/'), url)
    }

    /// A folder of any store.
    pub(in crate::store) fn over(
        store: Arc<dyn ObjectStore>,
        prefix: &str,
        shown: &str,
    ) -> Result<Self, Error> {
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let runtime = builder.worker_threads(1).thread_name("bucket").enable_all().build();
        let runtime = Some(runtime.map_err(io_error("starting the object store's client"))?);
        let shown = shown.trim_end_matches('/').to_owned();
        Ok(Self { store, prefix: prefix.to_owned(), shown, runtime })
    }

    fn path(&self, name: &str) -> Path {
        Path::from(format!("{}/{name}", self.prefix))
    }

    fn wait<T>(
        &self,
        request: impl Future<Output = Result<T, object_store::Error>>,
    ) -> Result<T, object_store::Error> {
        let Some(runtime) = &self.runtime else {
            return Err(object_store::Error::NotSupported { source: "the client was closed".into() });
        };
        runtime.block_on(request)
    }
}

/// A part of a request, which carries so many bytes.
async fn timely<T>(
    bytes: u64,
    part: impl Future<Output = Result<T, object_store::Error>>,
) -> Result<T, object_store::Error> {
    let time = TIMEOUT + PER_BYTE.saturating_mul(u32::try_from(bytes).unwrap_or(u32::MAX));
    let late = |late: tokio::time::error::Elapsed| {
        Err(object_store::Error::Generic { store: "the bucket", source: late.into() })
    };
    tokio::time::timeout(time, part).await.unwrap_or_else(late)
}

impl Drop for Remote {
    fn drop(&mut self) {
        // It may be dropped where nothing may block.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn failure(error: &object_store::Error) -> Failure {
    use object_store::Error as Store;
    let text = chain(error);
    match error {
        Store::PermissionDenied { .. }
        | Store::Unauthenticated { .. }
        | Store::InvalidPath { .. }
        | Store::NotImplemented { .. }
        | Store::NotSupported { .. }
        // There is no such bucket.
        | Store::NotFound { .. } => Failure::Refused(text),
        _ => Failure::Unknown(text),
    }
}

/// An error with its causes, without those that repeat what was said.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(next) = cause {
        let said = next.to_string();
        if !text.contains(&said) {
            text = format!("{text}: {said}");
        }
        cause = next.source();
    }
    text
}

impl Bucket for Remote {
    fn create(&self, name: &str, body: &[u8]) -> Result<Created, Failure> {
        let options = PutOptions { mode: PutMode::Create, ..PutOptions::default() };
        let path = self.path(name);
        let put = self.store.put_opts(&path, body.to_vec().into(), options);
        match self.wait(timely(body.len() as u64, put)) {
            Ok(_) => Ok(Created::Won),
            Err(object_store::Error::AlreadyExists { .. } | object_store::Error::Precondition { .. }) => {
                Ok(Created::Taken)
            }
            Err(error) => Err(failure(&error)),
        }
    }

    fn get(&self, name: &str, range: Option<Range<u64>>) -> Result<Option<Vec<u8>>, Failure> {
        let options = GetOptions { range: range.map(GetRange::Bounded), ..GetOptions::default() };
        let path = self.path(name);
        let got = self.wait(async {
            let got = timely(0, self.store.get_opts(&path, options)).await?;
            timely(got.range.end - got.range.start, got.bytes()).await
        });
        match got {
            Ok(bytes) => Ok(Some(bytes.to_vec())),
            Err(object_store::Error::NotFound { source, .. })
                if source.to_string().contains("NoSuchBucket") =>
            {
                Err(Failure::Refused(format!("there is no bucket {}", self.shown)))
            }
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(failure(&error)),
        }
    }

    fn list(&self, folder: &str) -> Result<Vec<Listed>, Failure> {
        let path = self.path(folder);
        let listed = self.wait(async {
            use tokio_stream::StreamExt as _;
            let mut all = Vec::new();
            let mut stream = self.store.list(Some(&path));
            while let Some(next) = timely(0, async { stream.next().await.transpose() }).await? {
                all.push(next);
            }
            Ok(all)
        });
        let mut listed: Vec<_> = listed
            .map_err(|error| failure(&error))?
            .into_iter()
            .map(|meta| {
                let name = meta.location.to_string();
                let name =
                    name.strip_prefix(&self.prefix).unwrap_or(&name).trim_start_matches('/').to_owned();
                Listed { name, bytes: meta.size, modified_us: meta.last_modified.timestamp_micros() }
            })
            .collect();
        listed.sort_unstable_by(|a, b| a.name.cmp(&b.name));
        Ok(listed)
    }

    fn delete(&self, name: &str) -> Result<(), Failure> {
        match self.wait(timely(0, self.store.delete(&self.path(name)))) {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(failure(&error)),
        }
    }

    fn locate(&self, name: &str) -> String {
        format!("{}/{name}", self.shown)
    }
}
