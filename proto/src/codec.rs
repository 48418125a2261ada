//! Messages between their bytes and their types.

use std::marker::PhantomData;

use prost::Message;
use prost::bytes::Buf;
use prost::encoding::decode_varint;
use tonic::Status;
use tonic::codec::{Codec, DecodeBuf, Decoder};
use tonic_prost::ProstEncoder;

/// Fields of a message and of the messages in it, at most: whole catalogs of tiles have fewer. A megabyte of empty messages
/// would take thirty.
const MAX_FIELDS: usize = 32_768;

/// The codec of the generated clients and services: prost's, decoding from one slice.
///
/// prost asks the transport's buffer for every number of a column, and that buffer is counted and
/// checked each time; of a slice, the columns of a batch decode several times faster.
#[derive(Debug, Clone)]
pub struct SliceCodec<T, U>(PhantomData<(T, U)>);

impl<T, U> Default for SliceCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> Codec for SliceCodec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = ProstEncoder<T>;
    type Decoder = SliceDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstEncoder::default()
    }

    fn decoder(&mut self) -> Self::Decoder {
        SliceDecoder(PhantomData)
    }
}

/// Decodes a message once all of it is there.
#[derive(Debug, Clone)]
pub struct SliceDecoder<U>(PhantomData<U>);

impl<U: Message + Default> Decoder for SliceDecoder<U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, buffer: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        // Takes the bytes over, without a copy.
        let message = buffer.copy_to_bytes(buffer.remaining());
        if fields(&message, 2) > MAX_FIELDS {
            return Err(Status::internal(format!("the message has more than {MAX_FIELDS} fields")));
        }
        // INTERNAL is what gRPC says to bytes that are no message; the service's port tells callers that it is theirs.
        U::decode(&message[..]).map(Some).map_err(|error| Status::internal(error.to_string()))
    }
}

/// Fields of a message down to so many levels, where messages may repeat; columns lie below. What does not follow the wire
/// format ends the count: decoding says what is wrong with it.
fn fields(mut rest: &[u8], levels: u8) -> usize {
    let mut count = 0;
    while count <= MAX_FIELDS && !rest.is_empty() {
        let Some(inside) = field(&mut rest) else { break };
        count += 1;
        if levels > 1 {
            count += fields(inside, levels - 1);
        }
    }
    count
}

/// Takes a field; returns what is inside it, of one that has a length.
fn field<'a>(rest: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = match decode_varint(rest).ok()? & 7 {
        0 => decode_varint(rest).map(|_| 0).ok()?,
        1 => return take(rest, 8).map(|_| &[][..]),
        2 => decode_varint(rest).ok()?,
        5 => return take(rest, 4).map(|_| &[][..]),
        _ => return None,
    };
    take(rest, usize::try_from(length).ok()?)
}

fn take<'a>(rest: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (taken, left) = rest.split_at_checked(count)?;
    *rest = left;
    Some(taken)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::v1::{Batch, GetTilesRequest, LocalizeRequest, Scans, SensorMount, TileVersion};

    /// Catches: a megabyte of empty messages, each of which takes forty bytes.
    #[test]
    fn empty_messages_by_the_thousand_are_counted_before_they_are_made() {
        let mounts = |count| Batch { mounts: vec![SensorMount::default(); count], ..Batch::default() };
        let asked = |count| LocalizeRequest { batch: Some(mounts(count)), ..LocalizeRequest::default() };
        assert_eq!(fields(&asked(64).encode_to_vec(), 2), 65);
        assert!(fields(&asked(500_000).encode_to_vec(), 2) > MAX_FIELDS);
        let have =
            |count| GetTilesRequest { have: vec![TileVersion::default(); count], ..Default::default() };
        assert_eq!(fields(&have(16_384).encode_to_vec(), 2), 16_384);
        assert!(fields(&have(500_000).encode_to_vec(), 2) > MAX_FIELDS);
    }

    #[test]
    fn columns_are_one_field_however_long() {
        let scans = Scans { range_m: vec![1.0; 100_000], sensor: vec![9; 100_000], ..Scans::default() };
        let batch = Some(Batch { scans: Some(scans), ..Batch::default() });
        let request = LocalizeRequest { batch, ..LocalizeRequest::default() };
        assert_eq!(fields(&request.encode_to_vec(), 2), 2);
        assert_eq!(fields(&[0xff; 100], 2), 0);
        assert_eq!(fields(&[0x0a, 0x7f, 1], 2), 0);
    }
}
