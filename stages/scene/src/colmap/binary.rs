//! COLMAP's binary files. Bounded: no count is believed that the file's own length does not back.

use super::model::{Image, Model, SparsePoint, camera_to_world, lens, model_by_number};

/// Bytes of the shortest records: a photo without points, a point without a track.
// Four bytes of number, 32 of rotation, 24 of translation, 4 of camera; a name's end; a count.
const IMAGE: usize = 64 + 1 + 8;
// Eight bytes of number, 24 of position, 3 of colour, 8 of error; a count.
const POINT: usize = 43 + 8;
const CAMERA: usize = 24 + 3 * 8;
/// Bytes of a photo's 2-D point (x, y, number) and of one step of a point's track (photo, 2-D
/// point).
const OBSERVATION: usize = 24;
const TRACK: usize = 8;

/// Bytes not read yet.
struct Cursor<'a>(&'a [u8]);

impl<'a> Cursor<'a> {
    fn bytes(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self
            .0
            .split_at_checked(count)
            .ok_or("the file ends in the middle of it")?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (taken, rest) = self
            .0
            .split_first_chunk::<N>()
            .ok_or("the file ends in the middle of it")?;
        self.0 = rest;
        Ok(*taken)
    }

    fn u32(&mut self) -> Result<u32, String> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, String> {
        self.array().map(u64::from_le_bytes)
    }

    fn reals<const N: usize>(&mut self) -> Result<[f64; N], String> {
        let mut reals = [0.0; N];
        for real in &mut reals {
            *real = self.array().map(f64::from_le_bytes)?;
        }
        Ok(reals)
    }

    /// A count of records of at least `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize, String> {
        let count = self.u64()?;
        // A damaged count must not ask for memory that the file cannot fill.
        let most = self.0.len() / least;
        match usize::try_from(count) {
            Ok(count) if count <= most => Ok(count),
            _ => Err(format!(
                "{count} records are announced, but what follows holds at most {most}"
            )),
        }
    }

    /// A text that ends with a zero byte.
    fn text(&mut self) -> Result<String, String> {
        // A name's length is not stored: without its zero byte it would not end.
        let end = self
            .0
            .iter()
            .position(|byte| *byte == 0)
            .ok_or("its name does not end")?;
        let text = std::str::from_utf8(&self.0[..end])
            .map_err(|_| "its name is not UTF-8")?
            .to_owned();
        self.0 = &self.0[end + 1..];
        Ok(text)
    }

    fn finish(&self) -> Result<(), String> {
        match self.0.len() {
            0 => Ok(()),
            // Bytes left over mean that a record was read with a wrong size.
            more => Err(format!("{more} bytes follow the last record")),
        }
    }
}

/// Reads each record of a file, and says in which one something is wrong.
fn records(
    bytes: &[u8],
    least: usize,
    mut record: impl FnMut(&mut Cursor) -> Result<(), String>,
) -> Result<(), (String, String)> {
    let mut cursor = Cursor(bytes);
    let whole = |fault| ("the file".to_owned(), fault);
    let count = cursor.count(least).map_err(whole)?;
    // No memory is reserved by the count: records are added as they are read.
    for index in 0..count {
        record(&mut cursor)
            .map_err(|fault| (format!("record {index} (counted from 0) of {count}"), fault))?;
    }
    cursor.finish().map_err(whole)
}

/// Reads `cameras.bin`. The error is a place and what is wrong there.
pub(super) fn cameras(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    records(bytes, CAMERA, |cursor| {
        let number = cursor.u32()?;
        let kind = cursor.u32()?;
        let size = (cursor.u64()?, cursor.u64()?);
        let (name, count) = model_by_number(kind as i32)?;
        let parameters = (0..count)
            .map(|_| cursor.reals::<1>().map(|[real]| real))
            .collect::<Result<Vec<_>, _>>()?;
        match model.lenses.insert(number, lens(name, size, &parameters)?) {
            None => Ok(()),
            Some(_) => Err(format!("camera {number} is there already")),
        }
    })
}

/// Reads `images.bin`; what points each photo shows is left to the points' own tracks.
pub(super) fn images(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    records(bytes, IMAGE, |cursor| {
        let number = cursor.u32()?;
        let turn = cursor.reals()?;
        let translation = cursor.reals()?;
        let lens = cursor.u32()?;
        let name = cursor.text()?;
        let observations = cursor.count(OBSERVATION)?;
        // Skipped: points3D has the same pairs, with positions.
        cursor.bytes(observations * OBSERVATION)?;
        model.add(
            number,
            Image {
                name,
                lens,
                camera_to_world: camera_to_world(turn, translation),
            },
        )
    })
}

/// Adds the points of `points3D.bin` to a model. Fails with the place in the file and what is wrong
/// there.
pub(super) fn points(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    records(bytes, POINT, |cursor| {
        // Its number, to which nothing that is read here refers.
        cursor.bytes(8)?;
        let position = cursor.reals()?;
        // Its colour.
        cursor.bytes(3)?;
        let [error] = cursor.reals()?;
        let length = cursor.count(TRACK)?;
        let track = cursor.bytes(length * TRACK)?.chunks_exact(TRACK);
        let seen_in = track
            .map(|step| u32::from_le_bytes([step[0], step[1], step[2], step[3]]))
            .collect();
        model.points.push(SparsePoint {
            position,
            error,
            seen_in,
        });
        Ok(())
    })
}
