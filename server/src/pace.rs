//! Bodies of requests: a peer that sends too slowly is given up, and what nobody reads is held or dropped.

use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use bytes::{Buf, Bytes};
use hyper::body::{Body, Frame, SizeHint};
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio::time::{Sleep, sleep_until};

/// An error of any kind, as bodies have them.
pub type BodyError = Box<dyn std::error::Error + Send + Sync>;

/// Bytes of a body that nobody reads which are received, at most, and for how long.
const DROPPED_BYTES: usize = 1 << 20;
const DROPPED_WITHIN: Duration = Duration::from_secs(5);

/// How long a body that nobody reads is held, so that what its peer sent before it was told is here when its stream is reset.
const HELD_FOR: Duration = Duration::from_millis(30);
/// A peer that has so few bytes left of its window waits for more: a frame of the usual size no longer fits.
const NEARLY_NOTHING: usize = 1 << 14;

/// How slowly a peer may send.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// The longest silence, and how far a peer may fall behind.
    pub stall: Duration,
    /// Bytes a second, over longer times.
    pub least_per_s: u64,
}

impl Pace {
    /// The time that a peer gets for so many bytes.
    pub(crate) fn time_for(&self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / self.least_per_s as f64)
    }
}

/// A peer sends too slowly.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the body comes too slowly: send {least_per_s} bytes a second or more, and pause for less than {} s", .stall.as_secs())]
pub struct TooSlow {
    stall: Duration,
    least_per_s: u64,
}

/// How far a peer is ahead of its pace. Only time in which the service waits for it counts.
#[derive(Debug)]
pub(crate) struct Ahead {
    pace: Pace,
    left: Duration,
    waiting: Option<Instant>,
}

impl Ahead {
    pub(crate) fn new(pace: Pace) -> Self {
        Self { pace, left: pace.stall, waiting: None }
    }

    pub(crate) fn came(&mut self, bytes: usize, now: Instant) {
        if let Some(since) = self.waiting.take() {
            self.left = self.left.saturating_sub(now.saturating_duration_since(since));
        }
        self.left = (self.left + self.pace.time_for(bytes)).min(self.pace.stall);
    }

    /// Until when the next bytes must come.
    pub(crate) fn until(&mut self, now: Instant) -> Instant {
        *self.waiting.get_or_insert(now) + self.left
    }
}

/// The body of a request, read at a least pace. Where it is dropped before its end, its peer may be sending: HTTP/2 counts what
/// comes for a call that the service has reset against its connection, where others have calls, too. So the rest is held until the
/// window of the stream is full, and only then reset: nothing more can come. Of a peer that is slower than that, or whose window
/// is not known, the rest is received and dropped, within bounds.
pub struct PacedBody<B>
where
    B: Body<Data = Bytes> + Unpin + Send + 'static,
    B::Error: Into<BodyError>,
{
    /// Absent once it has ended.
    inner: Option<B>,
    ahead: Option<Ahead>,
    timer: Option<Pin<Box<Sleep>>>,
    /// Turns true when the service ends: then nothing more is received.
    ending: watch::Receiver<bool>,
    /// Bytes that the peer may send before any are read.
    window: Option<usize>,
    /// How a late peer is told.
    told: fn(TooSlow) -> BodyError,
    runtime: Handle,
}

impl<B> PacedBody<B>
where
    B: Body<Data = Bytes> + Unpin + Send + 'static,
    B::Error: Into<BodyError>,
{
    /// A body that is read within this runtime; without a pace its peer may take its time.
    pub fn new(inner: B, pace: Option<Pace>, ending: watch::Receiver<bool>) -> Self {
        let (ahead, runtime) = (pace.map(Ahead::new), Handle::current());
        Self { inner: Some(inner), ahead, timer: None, ending, window: None, told: Into::into, runtime }
    }

    /// The same, with an error that a port's library understands.
    #[must_use]
    pub fn told(mut self, told: fn(TooSlow) -> BodyError) -> Self {
        self.told = told;
        self
    }

    /// The same, on streams with such a window.
    #[must_use]
    pub fn within(mut self, window: usize) -> Self {
        self.window = Some(window);
        self
    }

    /// The peer sent nothing: is it late?
    fn late(&mut self, context: &mut Context<'_>) -> Option<TooSlow> {
        let ahead = self.ahead.as_mut()?;
        let until = ahead.until(Instant::now()).into();
        let timer = self.timer.get_or_insert_with(|| Box::pin(sleep_until(until)));
        if timer.deadline() != until {
            timer.as_mut().reset(until);
        }
        let Pace { stall, least_per_s } = ahead.pace;
        timer.as_mut().poll(context).is_ready().then_some(TooSlow { stall, least_per_s })
    }
}

impl<B> Body for PacedBody<B>
where
    B: Body<Data = Bytes> + Unpin + Send + 'static,
    B::Error: Into<BodyError>,
{
    type Data = Bytes;
    type Error = BodyError;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, BodyError>>> {
        let Some(inner) = self.inner.as_mut() else { return Poll::Ready(None) };
        match Pin::new(inner).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                let bytes = frame.data_ref().map_or(0, Buf::remaining);
                if let Some(ahead) = &mut self.ahead {
                    ahead.came(bytes, Instant::now());
                }
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Ready(ended) => {
                self.inner = None;
                Poll::Ready(ended.map(|last| last.map_err(Into::into)))
            }
            Poll::Pending => match self.late(context) {
                Some(late) => {
                    self.inner = None;
                    Poll::Ready(Some(Err((self.told)(late))))
                }
                None => Poll::Pending,
            },
        }
    }

    fn is_end_stream(&self) -> bool {
        self.inner.as_ref().is_none_or(Body::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.as_ref().map_or_else(|| SizeHint::with_exact(0), Body::size_hint)
    }
}

impl<B> Drop for PacedBody<B>
where
    B: Body<Data = Bytes> + Unpin + Send + 'static,
    B::Error: Into<BodyError>,
{
    fn drop(&mut self) {
        let rest = self.inner.take().filter(|rest| !rest.is_end_stream() && !*self.ending.borrow());
        if let Some(rest) = rest {
            let (mut ending, window) = (self.ending.clone(), self.window);
            self.runtime.spawn(async move {
                tokio::select! {
                    () = let_go(rest, window) => {}
                    _ = ending.wait_for(|ending| *ending) => {}
                }
            });
        }
    }
}

/// Lets a body go that nobody reads.
async fn let_go<B: Body<Data = Bytes> + Unpin>(mut body: B, window: Option<usize>) {
    if let Some(window) = window {
        // Unread bytes are not granted again, so that the peer sends no more than fit into the window.
        tokio::time::sleep(HELD_FOR).await;
        let full = window.saturating_sub(NEARLY_NOTHING);
        if here(&mut body, full).await.is_none_or(|bytes| bytes > full) {
            return;
        }
    }
    // Who is still sending after its time goes on, or not.
    let _ = tokio::time::timeout(DROPPED_WITHIN, receive(body)).await;
}

/// Bytes of a body that are here, as far as there are no more than so many; nothing when that is all of it.
async fn here<B: Body<Data = Bytes> + Unpin>(body: &mut B, most: usize) -> Option<usize> {
    let mut bytes = 0;
    std::future::poll_fn(|context| {
        while bytes <= most {
            match Pin::new(&mut *body).poll_frame(context) {
                Poll::Ready(Some(Ok(frame))) => bytes += frame.data_ref().map_or(0, Bytes::len),
                Poll::Ready(Some(Err(_)) | None) => return Poll::Ready(None),
                Poll::Pending => break,
            }
        }
        Poll::Ready(Some(bytes))
    })
    .await
}

/// Receives and drops a body, up to some bytes.
async fn receive<B: Body<Data = Bytes> + Unpin>(mut body: B) {
    let mut left = DROPPED_BYTES;
    while let Some(Ok(frame)) = std::future::poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await
    {
        match left.checked_sub(frame.data_ref().map_or(0, Bytes::len)) {
            Some(less) => left = less,
            None => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body as AnyBody;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use tokio_stream::StreamExt;

    const PACE: Pace = Pace { stall: Duration::from_secs(20), least_per_s: 256 };

    /// After how many seconds a peer is given up that sends so many bytes every so often; none within an hour.
    fn given_up_after_s(bytes: usize, every: Duration) -> Option<u64> {
        let start = Instant::now();
        let (mut ahead, mut now) = (Ahead::new(PACE), start);
        while now < start + Duration::from_hours(1) {
            let until = ahead.until(now);
            now += every;
            if until < now {
                return Some((until - start).as_secs());
            }
            ahead.came(bytes, now);
        }
        None
    }

    /// Catches: a dribble that holds what it holds for ever, and a slow, honest vehicle that is cut off.
    #[test]
    fn a_least_rate_decides_and_no_gap_is_too_long() {
        let seconds = Duration::from_secs;
        assert_eq!(given_up_after_s(1_000, seconds(1)), None, "1 kB/s");
        assert_eq!(given_up_after_s(300, seconds(1)), None);
        assert_eq!(given_up_after_s(16_000, seconds(19)), None);
        assert_eq!(given_up_after_s(1 << 20, seconds(21)), Some(20));
        assert_eq!(given_up_after_s(0, seconds(5)), Some(20));
        assert!(given_up_after_s(1, seconds(1)).unwrap() <= 21);
        assert!(given_up_after_s(128, seconds(1)).unwrap() <= 41);
    }

    fn ending() -> (watch::Sender<bool>, watch::Receiver<bool>) {
        watch::channel(false)
    }

    #[tokio::test]
    async fn a_peer_that_falls_silent_is_given_up_with_words() {
        let (_sender, ending) = ending();
        let silent = AnyBody::from_stream(tokio_stream::pending::<Result<Bytes, std::io::Error>>());
        let body = PacedBody::new(silent, Some(Pace { stall: Duration::from_millis(20), ..PACE }), ending);
        let error = axum::body::to_bytes(AnyBody::new(body), 9).await.unwrap_err();
        let words = std::error::Error::source(&error).unwrap().to_string();
        assert!(words.contains("256 bytes a second"), "{words}");
    }

    /// Catches: a refused call whose rest is answered with resets, which end the connection for others.
    #[tokio::test]
    async fn what_nobody_reads_is_received_within_bounds() {
        let taken = |chunks: usize| async move {
            let (_sender, ending) = ending();
            let count = Arc::new(AtomicUsize::new(0));
            let counted = count.clone();
            let chunks = tokio_stream::iter(0..chunks).map(move |_| {
                counted.fetch_add(1, Ordering::Relaxed);
                Ok::<_, std::io::Error>(Bytes::from(vec![0; 1 << 16]))
            });
            drop(PacedBody::new(AnyBody::from_stream(chunks), None, ending));
            // Each turn of the runtime lets what was spawned go on.
            for _ in 0..1_000 {
                tokio::task::yield_now().await;
            }
            count.load(Ordering::Relaxed)
        };
        assert_eq!(taken(3).await, 3);
        assert_eq!(taken(500).await, 17);
    }

    /// Catches: a refused call of which the service takes all, on a stream whose window is full.
    #[tokio::test]
    async fn what_fills_its_window_is_held_and_then_reset() {
        let (_sender, ending) = ending();
        let count = Arc::new(AtomicUsize::new(0));
        let counted = Arc::clone(&count);
        let (dropped, is_dropped) = tokio::sync::oneshot::channel::<()>();
        let chunks = tokio_stream::iter(0..500).map(move |_| {
            let _held = &dropped;
            counted.fetch_add(1, Ordering::Relaxed);
            Ok::<_, std::io::Error>(Bytes::from(vec![0; 1 << 14]))
        });
        drop(PacedBody::new(AnyBody::from_stream(chunks), None, ending).within(1 << 16));
        assert_eq!(count.load(Ordering::Relaxed), 0, "nothing is read at once");
        assert!(is_dropped.await.is_err());
        assert_eq!(count.load(Ordering::Relaxed), 4);
    }
}
