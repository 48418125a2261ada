//! Frames that carry no request: `PING`, `SETTINGS`, `PRIORITY`, `WINDOW_UPDATE`, `RST_STREAM`, `DATA` that is empty, tiny or
//! mere padding, and those nobody knows.
//!
//! Each costs the sender nothing and the service an answer or a look. The HTTP/2 library takes them for ever (a reset of a stream
//! that is over, too), so they are counted here, in the bytes of the connection as they come in. What requests and answers need
//! is granted on the way: for each request some, for what it brings some, and some for what was sent, because who reads must say
//! so.

use std::time::Instant;

/// How HTTP/2 begins; anything else has no frames.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";
/// Bytes before a frame's payload.
const HEADER: usize = 9;
/// Frames in stock at most, and granted a second: a thousand in two seconds.
const STOCK: f64 = 1_000.0;
const PER_SECOND: f64 = 500.0;
/// Frames granted for a request, and bytes sent for which one more is.
const PER_REQUEST: f64 = 4.0;
const BYTES_SENT: f64 = 2_048.0;
/// `DATA` that brings less is counted, and bytes of it for which a frame is granted: some send the five bytes before a message
/// in a frame of their own.
const TINY: usize = 64;
const BYTES_BROUGHT: f64 = 1_024.0;

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const CONTINUATION: u8 = 9;
const END_STREAM: u8 = 1;
const PADDED: u8 = 8;

/// Counts the frames of one connection.
#[derive(Debug)]
pub(super) struct FrameCount {
    place: Place,
    stock: f64,
    since: Instant,
}

/// Where in the stream of bytes the next one lies.
#[derive(Debug)]
enum Place {
    /// So many bytes of the preface came.
    Preface(usize),
    /// So many bytes of a frame's header came.
    Header([u8; HEADER], usize),
    /// So many bytes of a payload are to come.
    Payload(usize),
    /// This is no HTTP/2.
    Elsewhere,
}

impl FrameCount {
    pub(super) fn new(now: Instant) -> Self {
        Self { place: Place::Preface(0), stock: STOCK, since: now }
    }

    /// Looks at the next bytes of the caller; false once there were too many such frames.
    pub(super) fn take(&mut self, mut bytes: &[u8], now: Instant) -> bool {
        let seconds = now.saturating_duration_since(self.since).as_secs_f64();
        self.since = now;
        self.grant(PER_SECOND * seconds);
        while !bytes.is_empty() && self.stock >= 0.0 {
            let taken = self.step(bytes);
            bytes = &bytes[taken..];
        }
        self.stock >= 0.0
    }

    /// Notes that so many bytes were sent.
    pub(super) fn sent(&mut self, bytes: usize) {
        self.grant(bytes as f64 / BYTES_SENT);
    }

    fn grant(&mut self, frames: f64) {
        self.stock = (self.stock + frames).min(STOCK);
    }

    /// Takes some bytes, one at least.
    fn step(&mut self, bytes: &[u8]) -> usize {
        match &mut self.place {
            Place::Elsewhere => bytes.len(),
            Place::Preface(came) => {
                let part = &PREFACE[*came..(*came + bytes.len()).min(PREFACE.len())];
                *came += part.len();
                let whole = *came == PREFACE.len();
                if !bytes.starts_with(part) {
                    self.place = Place::Elsewhere;
                } else if whole {
                    self.place = Place::Header([0; HEADER], 0);
                }
                part.len()
            }
            Place::Payload(left) => {
                let taken = bytes.len().min(*left);
                *left -= taken;
                if *left == 0 {
                    self.place = Place::Header([0; HEADER], 0);
                }
                taken
            }
            Place::Header(header, came) => {
                let taken = bytes.len().min(HEADER - *came);
                header[*came..*came + taken].copy_from_slice(&bytes[..taken]);
                *came += taken;
                if *came == HEADER {
                    let header = *header;
                    self.frame(header);
                }
                taken
            }
        }
    }

    fn frame(&mut self, [high, middle, low, kind, flags, ..]: [u8; HEADER]) {
        let length = u32::from_be_bytes([0, high, middle, low]) as usize;
        self.place = if length > 0 { Place::Payload(length) } else { Place::Header([0; HEADER], 0) };
        match kind {
            // What of it is padding is not known yet, and honest callers pad nothing.
            DATA if length >= TINY && flags & PADDED == 0 => self.grant(length as f64 / BYTES_BROUGHT),
            // The last of a request, which was granted more.
            DATA if flags & END_STREAM != 0 => {}
            HEADERS => self.grant(PER_REQUEST),
            // It has a bound of its own in the library.
            CONTINUATION => {}
            _ => self.stock -= 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const RST_STREAM: u8 = 3;

    fn frame(kind: u8, payload: usize) -> Vec<u8> {
        let length = (payload as u32).to_be_bytes();
        [&length[1..], &[kind, 0, 0, 0, 0, 1], &vec![0; payload]].concat()
    }

    /// Whether as many frames are taken, in pieces of so many bytes.
    fn taken(frames: &[u8], times: usize, piece: usize) -> bool {
        let now = Instant::now();
        let mut count = FrameCount::new(now);
        let bytes = [PREFACE, &frames.repeat(times)].concat();
        bytes.chunks(piece).all(|piece| count.take(piece, now))
    }

    /// Catches: a flood that is taken for ever, and one that is not seen because of how its bytes are cut.
    #[test]
    fn floods_of_frames_that_carry_nothing_end_the_connection() {
        const KINDS: [(u8, usize); 8] =
            [(6, 8), (4, 0), (2, 5), (8, 4), (RST_STREAM, 4), (0xbb, 30), (DATA, 0), (DATA, 5)];
        for (kind, payload) in KINDS {
            for piece in [1, 7, 9, 1_000, 1 << 20] {
                assert!(taken(&frame(kind, payload), 900, piece), "{kind}");
                assert!(!taken(&frame(kind, payload), 1_100, piece), "{kind}");
            }
        }
    }

    #[test]
    fn requests_and_data_are_taken_without_end() {
        let request = [frame(HEADERS, 40), frame(DATA, 9_000), frame(8, 4), frame(8, 4)].concat();
        assert!(taken(&request, 5_000, 1_400));
        assert!(taken(&frame(DATA, 100), 50_000, 1 << 16));
        assert!(taken(&[frame(HEADERS, 40), frame(RST_STREAM, 4)].concat(), 5_000, 1 << 16));
        // Some send the five bytes before a message in a frame of their own.
        assert!(taken(&[frame(DATA, 5), frame(DATA, 4_000)].concat(), 5_000, 1 << 16));
    }

    /// Catches: padding that is taken for data.
    #[test]
    fn mere_padding_is_no_data() {
        let mut padding = frame(DATA, 256);
        (padding[4], padding[HEADER]) = (PADDED, 255);
        assert!(!taken(&padding, 1_100, 1 << 16));
    }

    #[test]
    fn who_is_sent_much_may_say_so_often_and_all_is_granted_again_in_time() {
        let start = Instant::now();
        let mut count = FrameCount::new(start);
        assert!(count.take(PREFACE, start));
        for _ in 0..10_000 {
            count.sent(32 << 10);
            assert!(count.take(&frame(8, 4).repeat(2), start));
        }
        let mut later = start;
        for _ in 0..100 {
            later += Duration::from_secs(2);
            assert!(count.take(&frame(6, 8).repeat(990), later));
        }
        assert!(!count.take(&frame(6, 8).repeat(1_100), later));
    }

    #[test]
    fn what_is_no_http2_is_not_looked_at() {
        let mut count = FrameCount::new(Instant::now());
        let bytes = [b"GET / HTTP/1.1\r\n\r\n".to_vec(), frame(6, 8).repeat(5_000)].concat();
        assert!(count.take(&bytes, Instant::now()));
    }
}
