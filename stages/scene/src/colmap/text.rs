//! COLMAP's text files: one record a line, `#` before comments. Knows nothing of the binary ones.

use std::str::FromStr;

use super::model::{Image, Model, SparsePoint, camera_to_world, lens, model_by_name};
use crate::source_files;

/// The words of a line, taken one by one.
struct Words<'a>(std::str::SplitWhitespace<'a>);

impl<'a> Words<'a> {
    fn word(&mut self, what: &str) -> Result<&'a str, String> {
        self.0.next().ok_or_else(|| format!("{what} is missing"))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, String> {
        let word = self.word(what)?;
        word.parse()
            .map_err(|_| format!("{what} is `{word}`; expected a number"))
    }

    fn reals<const N: usize>(&mut self, what: &str) -> Result<[f64; N], String> {
        let mut reals = [0.0; N];
        for real in &mut reals {
            *real = self.number(what)?;
        }
        Ok(reals)
    }
}

/// The records of a file: its lines that are no comments, by number from 1.
struct Lines<'a> {
    rest: std::iter::Peekable<std::iter::Enumerate<std::str::Lines<'a>>>,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Option<(usize, &'a str)> {
        // Comments begin a line in COLMAP's files; a `#` within one is part of a name.
        let is_record = |text: &str| !text.trim().is_empty() && !text.starts_with('#');
        self.rest
            .find(|(_, text)| is_record(text))
            .map(|(index, text)| (index + 1, text))
    }
}

/// Reads each record, and says in which line something is wrong.
fn records(
    bytes: &[u8],
    mut record: impl FnMut(Words, &mut Lines) -> Result<(), String>,
) -> Result<(), (String, String)> {
    let text =
        source_files::as_text(bytes.to_vec()).map_err(|fault| ("the file".to_owned(), fault))?;
    let mut lines = Lines {
        rest: text.lines().enumerate().peekable(),
    };
    while let Some((number, text)) = lines.next() {
        record(Words(text.split_whitespace()), &mut lines)
            .map_err(|fault| (format!("line {number}"), fault))?;
    }
    Ok(())
}

/// Reads `cameras.txt`: CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]. The error is a place and what is
/// wrong there.
pub(super) fn cameras(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    records(bytes, |mut words, _| {
        let number = words.number("CAMERA_ID")?;
        let (name, count) = model_by_name(words.word("MODEL")?)?;
        let size = (words.number("WIDTH")?, words.number("HEIGHT")?);
        let parameters = (0..count)
            .map(|_| words.number("PARAMS"))
            .collect::<Result<Vec<f64>, _>>()?;
        if let Some(word) = words.0.next() {
            return Err(format!("{name} has {count} PARAMS; `{word}` is one more"));
        }
        match model.lenses.insert(number, lens(name, size, &parameters)?) {
            None => Ok(()),
            Some(_) => Err(format!("CAMERA_ID {number} is there already")),
        }
    })
}

/// Reads `images.txt`: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, each followed by a line of 2-D
/// points, perhaps empty. Some tools leave the second line out, which is noted.
pub(super) fn images(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    let mut without_points = 0;
    records(bytes, |mut words, lines| {
        // The order of fields is COLMAP's; counts stand in comments, which are not believed.
        let number = words.number("IMAGE_ID")?;
        let turn = words.reals("QW QX QY QZ")?;
        let translation = words.reals("TX TY TZ")?;
        let lens = words.number("CAMERA_ID")?;
        let first = words.word("NAME")?;
        // Names may hold spaces.
        let name = words
            .0
            .fold(first.to_owned(), |name, word| name + " " + word);
        // The rest is looked at with blank lines: an image without points has an empty second line.
        match lines.rest.peek().map(|(_, text)| second_line(text)) {
            Some(Second::Points) => drop(lines.rest.next()),
            Some(Second::NextImage) => without_points += 1,
            Some(Second::Neither) => {
                return Err(format!(
                    "the line after that of {name} is neither its points (X Y POINT3D_ID ...) nor another image"
                ));
            }
            None => {}
        }
        model.add(
            number,
            Image {
                name,
                lens,
                camera_to_world: camera_to_world(turn, translation),
            },
        )
    })?;
    if without_points > 0 {
        model.notes.push(format!(
            "{without_points} of {} records of images.txt have no line of points after them, as COLMAP's format wants it: \
             they are read as records of one line",
            model.images.len()
        ));
    }
    Ok(())
}

/// What follows the line of an image.
enum Second {
    Points,
    NextImage,
    Neither,
}

fn second_line(text: &str) -> Second {
    let words: Vec<&str> = text.split_whitespace().collect();
    let are_numbers = |words: &[&str]| words.iter().all(|word| word.parse::<f64>().is_ok());
    if text.starts_with('#') {
        return Second::NextImage;
    }
    // Triples of numbers, perhaps none. An image's line ends with a name, hardly ever a number.
    if words.len().is_multiple_of(3) && are_numbers(&words) {
        return Second::Points;
    }
    // Nine numbers and a name make an image's own line.
    match words.len() >= 10 && are_numbers(&words[..9]) {
        true => Second::NextImage,
        false => Second::Neither,
    }
}

/// Reads `points3D.txt`: POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID, POINT2D_IDX).
pub(super) fn points(bytes: &[u8], model: &mut Model) -> Result<(), (String, String)> {
    records(bytes, |mut words, _| {
        words.word("POINT3D_ID")?;
        let position = words.reals("X Y Z")?;
        let [_, _, _, error] = words.reals("R G B ERROR")?;
        let mut seen_in = Vec::new();
        while let Some(image) = words.0.next() {
            seen_in.push(
                image
                    .parse()
                    .map_err(|_| format!("IMAGE_ID is `{image}`; expected a number"))?,
            );
            // Read to keep in step; only the photo matters.
            words.word("POINT2D_IDX")?;
        }
        model.points.push(SparsePoint {
            position,
            error,
            seen_in,
        });
        Ok(())
    })
}
