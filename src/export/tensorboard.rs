//! TensorBoard's event files: records of one step each, as TensorFlow writes them. Knows nothing of
//! runs.
//!
//! A record is its length, a check of the length, its bytes and a check of those; the bytes are an
//! `Event` as Protocol Buffers write it (tensorflow/core/util/event.proto, framework/summary.proto).

/// What an event file is called; TensorBoard takes every file with `tfevents` in its name.
pub const FILE: &str = "events.out.tfevents.srnerf-dag";

/// Fields of an `Event`, and their types on the wire: 0 a varint, 1 eight bytes, 2 a length and
/// bytes, 5 four bytes.
const WALL_TIME: u8 = 1 << 3 | 1;
const STEP: u8 = 2 << 3;
const FILE_VERSION: u8 = 3 << 3 | 2;
const SUMMARY: u8 = 5 << 3 | 2;
/// Fields of a `Summary`, and of its values.
const VALUE: u8 = 1 << 3 | 2;
const TAG: u8 = 1 << 3 | 2;
const SIMPLE_VALUE: u8 = 2 << 3 | 5;

/// The events of one run, in the order of their steps.
pub struct Events {
    bytes: Vec<u8>,
}

impl Events {
    /// An event file with nothing in it yet.
    pub fn new() -> Self {
        let mut version = Vec::new();
        // The first record of a file tells the version of its format.
        message(&mut version, FILE_VERSION, b"brain.Event:2");
        let mut events = Self { bytes: Vec::new() };
        events.record(&version);
        events
    }

    /// Adds the scalars of a step. A step is told to have been taken so many seconds after 1970:
    /// logs know no other time, and the same log makes the same file.
    pub fn step<'a>(&mut self, step: u64, scalars: impl IntoIterator<Item = (&'a str, f64)>) {
        let mut summary = Vec::new();
        for (tag, scalar) in scalars {
            let mut value = Vec::new();
            message(&mut value, TAG, tag.as_bytes());
            value.push(SIMPLE_VALUE);
            value.extend((scalar as f32).to_le_bytes());
            message(&mut summary, VALUE, &value);
        }
        let mut event = vec![WALL_TIME];
        event.extend((step as f64).to_le_bytes());
        event.push(STEP);
        varint(&mut event, step);
        message(&mut event, SUMMARY, &summary);
        self.record(&event);
    }

    fn record(&mut self, event: &[u8]) {
        let length = (event.len() as u64).to_le_bytes();
        self.bytes.extend(length);
        self.bytes.extend(check(&length));
        self.bytes.extend(event);
        self.bytes.extend(check(event));
    }

    /// The file.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

fn message(into: &mut Vec<u8>, field: u8, bytes: &[u8]) {
    into.push(field);
    varint(into, bytes.len() as u64);
    into.extend(bytes);
}

/// Seven bits a byte, the lowest first; all bytes but the last have their highest bit set.
fn varint(into: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        into.push(value as u8 | 0x80);
        value >>= 7;
    }
    into.push(value as u8);
}

/// CRC-32C, turned and shifted, so that the check of bytes that hold a check is no accident.
fn check(bytes: &[u8]) -> [u8; 4] {
    let crc = crc32c::crc32c(bytes);
    // `kMaskDelta` of TensorFlow's crc32c.h.
    crc.rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_written_as_tensorflow_writes_it() {
        // By TensorBoard's own writer: `tests/tensorboard/read.py golden`.
        let mut events = Events::new();
        events.step(300, [("loss", 0.5)]);
        let written: Vec<String> = events
            .bytes()
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(written.concat(), GOLDEN);
    }

    const GOLDEN: &str = "0f000000000000006d532b091a0d627261696e2e4576656e743a32fc9851291b000000000000001a0d9e13090000000000c0724010ac022a0d0a0b0a046c6f7373150000003f27554a2e";
}
