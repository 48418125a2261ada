//! What one client or many may cost: lengths, times, permits.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::Request;
use axum::http::{HeaderName, HeaderValue, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;

use super::error::Error;
use crate::patience::Patience;
use crate::shares::{Peer, Place, Pool};
use crate::trace::in_current_span;

/// Longest address served, bytes; the longest sensible one is a tenth of it.
const MAX_ADDRESS: usize = 1024;
/// ... and of where an issuer sends browsers back to: some put whole tokens into a code.
const MAX_CALLBACK: usize = 8 << 10;
/// Time for an answer to begin.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);
/// Time for an operation on the whole map to be done: it may fold the journal again.
const OPERATE_WITHIN: Duration = Duration::from_hours(1);
/// Looks at the whole map at once, and decisions about it.
const OPERATIONS: usize = 4;
const DECISIONS: usize = 2;
/// Files that are sent or received at once.
const TRANSFERS: usize = 4;
/// Requests that may wait for a permit to render.
const WAITING: usize = 64;
/// Time a request waits for a permit to render.
const WAIT_AT_MOST: Duration = Duration::from_secs(5);
/// Event streams open at once.
const LISTENERS: usize = 64;

/// Refuses long addresses and ends slow answers.
pub async fn guard(request: Request, next: Next) -> Response {
    let uri = request.uri();
    let length = uri.path().len() + uri.query().map_or(0, str::len);
    let limit = if uri.path() == "/session/callback" { MAX_CALLBACK } else { MAX_ADDRESS };
    if length > limit {
        return Error::AddressTooLong { limit }.into_response();
    }
    let operation = uri.path().starts_with("/api/v1/map/");
    let within = if operation { OPERATE_WITHIN } else { ANSWER_WITHIN };
    let late = Error::TimedOut { seconds: within.as_secs() };
    let answer = timeout(within, next.run(request)).await;
    with_safe_headers(answer.unwrap_or_else(|_| late.into_response()))
}

fn with_safe_headers(mut response: Response) -> Response {
    let headers = response.headers_mut();
    let always: [(HeaderName, &'static str); 3] = [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-site"),
    ];
    for (name, value) in always {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

/// Permits to work, so that many page views cannot take the machine from the vehicles.
pub struct Limiter {
    waiting: Arc<Pool>,
    working: Arc<Semaphore>,
    listening: Arc<Pool>,
    operating: Arc<Pool>,
    transferring: Arc<Pool>,
    /// Nobody who only looks at the map can keep an operator from deciding about it.
    deciding: Arc<Semaphore>,
}

impl Limiter {
    /// The limits of a port, of which one peer may have a share.
    pub fn of_port(share: f64) -> Self {
        let cores = std::thread::available_parallelism().map_or(2, usize::from);
        Self::new((WAITING, cores.div_ceil(2), LISTENERS), share)
    }

    /// So many may wait, work and listen at once.
    fn new((waiting, working, listening): (usize, usize, usize), share: f64) -> Self {
        let semaphore = |n| Arc::new(Semaphore::new(n));
        Self {
            waiting: Pool::new(waiting, share),
            working: semaphore(working),
            listening: Pool::new(listening, share),
            operating: Pool::new(OPERATIONS, share),
            transferring: Pool::new(TRANSFERS, share),
            deciding: semaphore(DECISIONS),
        }
    }

    /// Runs blocking work once there is a permit for it.
    ///
    /// # Errors
    /// When too many wait already or the wait is too long.
    pub async fn work<T: Send + 'static>(
        &self,
        peer: Peer,
        work: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        self.attended(peer, move |_| work()).await
    }

    /// The same for work that may take long: it looks between its steps whether its caller still waits.
    ///
    /// # Errors
    /// When too many wait already, the wait is too long, or the caller is gone.
    pub async fn attended<T: Send + 'static>(
        &self,
        peer: Peer,
        work: impl FnOnce(&Patience) -> Result<T, Error> + Send + 'static,
    ) -> Result<T, Error> {
        const FULL: Error = Error::Saturated("all permits to render are taken");
        let queued = self.waiting.take(peer).ok_or(FULL)?;
        let permit = timeout(WAIT_AT_MOST, Arc::clone(&self.working).acquire_owned()).await;
        let permit = permit.map_err(|_| FULL)?.map_err(|_| FULL)?;
        let (patience, _waiting) = Patience::until(None);
        tokio::task::spawn_blocking(in_current_span(move || {
            // Held by the work, not by the request: a client that hangs up frees no permit early.
            let _held = (queued, permit);
            if patience.is_over() { Err(Error::Gone) } else { work(&patience) }
        }))
        .await?
    }

    /// A place for a look at the whole map, returned when dropped.
    ///
    /// # Errors
    /// When all are taken.
    pub fn operate(&self, peer: Peer) -> Result<Place, Error> {
        self.operating.take(peer).ok_or(Error::Saturated("other operations on the map are under way"))
    }

    /// A permit for a decision about the map, returned when dropped.
    ///
    /// # Errors
    /// When all are taken.
    pub fn decide(&self) -> Result<OwnedSemaphorePermit, Error> {
        const FULL: Error = Error::Saturated("other decisions about the map are under way");
        Arc::clone(&self.deciding).try_acquire_owned().map_err(|_| FULL)
    }

    /// A place for a file that comes or goes at its peer's pace, returned when dropped.
    ///
    /// # Errors
    /// When all are taken.
    pub fn transfer(&self, peer: Peer) -> Result<Place, Error> {
        self.transferring.take(peer).ok_or(Error::Saturated("other files are being sent or received"))
    }

    /// A place for an event stream, returned when dropped.
    ///
    /// # Errors
    /// When all are taken.
    pub fn listen(&self, peer: Peer) -> Result<Place, Error> {
        self.listening.take(peer).ok_or(Error::Saturated("all event streams are taken"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn requests_beyond_the_queue_are_refused_at_once() {
        let limiter = Limiter::new((1, 1, 1), 1.0);
        let (release, wait) = std::sync::mpsc::channel::<()>();
        let busy = limiter.work(Peer::unknown(), move || Ok(wait.recv().is_ok()));
        let turned_away = async {
            let answer = limiter.work(Peer::unknown(), || Ok(())).await;
            release.send(()).unwrap();
            answer
        };
        let (busy, turned_away) = tokio::join!(busy, turned_away);
        assert!(busy.unwrap());
        assert!(matches!(turned_away, Err(Error::Saturated(_))));
        limiter.work(Peer::unknown(), || Ok(())).await.unwrap();
    }

    /// Catches: a picture of a whole city that is drawn for a page that was closed.
    #[tokio::test]
    async fn work_ends_with_its_caller() {
        let limiter = Limiter::new((1, 1, 1), 1.0);
        let (ended, end) = std::sync::mpsc::channel();
        let work = limiter.attended(Peer::unknown(), move |patience| {
            while !patience.is_over() {
                std::thread::sleep(Duration::from_millis(1));
            }
            Ok(ended.send(()).is_ok())
        });
        assert!(timeout(Duration::from_millis(20), work).await.is_err());
        assert!(end.recv_timeout(Duration::from_secs(2)).is_ok());
    }

    #[test]
    fn listeners_are_bounded_and_their_permit_comes_back() {
        let limiter = Limiter::new((1, 1, 1), 1.0);
        let first = limiter.listen(Peer::unknown()).unwrap();
        assert!(matches!(limiter.listen(Peer::unknown()), Err(Error::Saturated(_))));
        drop(first);
        assert!(limiter.listen(Peer::unknown()).is_ok());
    }
}
