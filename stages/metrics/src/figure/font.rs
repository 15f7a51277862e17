//! A bitmap font of printable ASCII: 5x7 letterforms with two rows for descenders, set
//! proportionally. Knows nothing of where or in which colour text is drawn.

/// Rows of a glyph: seven above the baseline, two below.
pub(super) const GLYPH_ROWS: usize = 9;
/// Columns of a glyph on the sheet, the gap to its neighbour included.
const CELL: usize = 6;
/// Empty columns between glyphs.
const TRACKING: usize = 1;
/// Width of a space.
const SPACE: usize = 3;

/// The ink of `text` as (column, row) of unit squares, from the left and from the cap line.
/// Characters outside printable ASCII show as `?`.
pub(super) fn ink(text: &str) -> Vec<(usize, usize)> {
    let mut left = 0;
    let mut squares = Vec::new();
    for character in text.chars() {
        squares.extend(glyph(character).map(|(x, y)| (left + x, y)));
        left += advance(character);
    }
    squares
}

/// The columns that `text` takes.
pub(super) fn width(text: &str) -> usize {
    text.chars()
        .map(advance)
        .sum::<usize>()
        .saturating_sub(TRACKING)
}

/// From one glyph's left edge to the next's.
fn advance(character: char) -> usize {
    // Only the space has no ink.
    glyph(character).map(|(x, _)| x + 1).max().unwrap_or(SPACE) + TRACKING
}

/// The inked (column, row) of a character on its cell.
fn glyph(character: char) -> impl Iterator<Item = (usize, usize)> {
    let code = if (' '..='~').contains(&character) {
        character
    } else {
        '?'
    } as usize
        - 0x20;
    let top = code / 16 * GLYPH_ROWS;
    let left = code % 16 * CELL;
    let cell = (0..GLYPH_ROWS).flat_map(|y| (0..CELL).map(move |x| (x, y)));
    cell.filter(move |(x, y)| SHEET[top + y].as_bytes()[left + x] == b'#')
}

/// Sixteen characters a line from the space on, each on 6x9 cells.
#[rustfmt::skip]
const SHEET: [&str; 6 * GLYPH_ROWS] = [
    "      #     # #    # #    #   ##  #  ##   #       #   #                                       # ",
    "      #     # #    # #   #### ## #  #  #  #      #     #      #     #                        #  ",
    "      #           ##### # #      #  # #         #       #   # # #   #                        #  ",
    "      #            # #   ###    #    #          #       #    ###  #####       ####          #   ",
    "      #           #####   # #  #    # # #       #       #   # # #   #                      #    ",
    "                   # #  ####   # ## #  #         #     #      #     #    #          ##     #    ",
    "      #            # #    #   #  ##  ## #         #   #                  #          ##    #     ",
    "                                                                        #                       ",
    "                                                                                                ",
    " ###   #     ###   ###     #  #####   ##  #####  ###   ###                 #        #      ###  ",
    "#   # ##    #   # #   #   ##  #      #        # #   # #   #               #          #    #   # ",
    "#  ##  #        #     #  # #  ####  #        #  #   # #   # ##    ##     #    ####    #       # ",
    "# # #  #       #    ##  #  #      # ####    #    ###   #### ##    ##    #              #     #  ",
    "##  #  #      #       # #####     # #   #  #    #   #     #              #    ####    #     #   ",
    "#   #  #     #    #   #    #  #   # #   #  #    #   #    #  ##     #      #          #          ",
    " ###  ###   #####  ###     #   ###   ###   #     ###   ##   ##     #       #        #       #   ",
    "                                                                  #                             ",
    "                                                                                                ",
    " ###    #   ####   ###  ####  ##### #####  ###  #   # ###       # #   # #     #   # #   #  ###  ",
    "#   #  # #  #   # #   # #   # #     #     #   # #   #  #        # #  #  #     ## ## ##  # #   # ",
    "# ### #   # #   # #     #   # #     #     #     #   #  #        # # #   #     # # # ##  # #   # ",
    "# # # #   # ####  #     #   # ####  ####  # ### #####  #        # ##    #     # # # # # # #   # ",
    "# ### ##### #   # #     #   # #     #     #   # #   #  #    #   # # #   #     #   # #  ## #   # ",
    "#     #   # #   # #   # #   # #     #     #   # #   #  #    #   # #  #  #     #   # #  ## #   # ",
    " #### #   # ####   ###  ####  ##### #      ###  #   # ###    ###  #   # ##### #   # #   #  ###  ",
    "                                                                                                ",
    "                                                                                                ",
    "####   ###  ####   #### ##### #   # #   # #   # #   # #   # ##### ##    #     ##      #         ",
    "#   # #   # #   # #       #   #   # #   # #   # #   # #   #     # #      #     #     # #        ",
    "#   # #   # #   # #       #   #   # #   # #   #  # #   # #     #  #      #     #    #   #       ",
    "####  #   # ####   ###    #   #   # #   # # # #   #     #     #   #       #    #                ",
    "#     # # # # #       #   #   #   #  # #  # # #  # #    #    #    #        #   #                ",
    "#     #  #  #  #      #   #   #   #  # #  ## ## #   #   #   #     #        #   #                ",
    "#      ## # #   # ####    #    ###    #   #   # #   #   #   ##### ##        # ##                ",
    "                                                                                          ##### ",
    "                                                                                                ",
    "#           #               #         ##        #     #       #   #     #                       ",
    " #          #               #        #          #                 #     #                       ",
    "       ###  ####   ###   ####  ###  ####   #### ####  #       #   #  #  #     ## #  ####   ###  ",
    "          # #   # #     #   # #   #  #    #   # #   # #       #   # #   #     # # # #   # #   # ",
    "       #### #   # #     #   # #####  #    #   # #   # #       #   ##    #     # # # #   # #   # ",
    "      #   # #   # #     #   # #      #    #   # #   # #       #   # #   #     # # # #   # #   # ",
    "       #### ####   ###   ####  ###   #     #### #   # #       #   #  #   #    # # # #   #  ###  ",
    "                                              #               #                                 ",
    "                                           ###              ##                                  ",
    "                         #                                          #   #     #                 ",
    "                         #                                         #    #      #                ",
    "####   #### # ##   ###  ####  #   # #   # #   # #   # #   # ####   #    #      #     #          ",
    "#   # #   # ##    #      #    #   # #   # #   #  # #  #   #    #  #     #       #   # # #       ",
    "#   # #   # #      ##    #    #   # #   # # # #   #   #   #  ##    #    #      #       #        ",
    "#   # #   # #        #   #    #   #  # #  # # #  # #  #   # #      #    #      #                ",
    "####   #### #     ###     ##   ####   #    # #  #   #  #### ####    #   #     #                 ",
    "#         #                                               #                                     ",
    "#         #                                            ###                                      ",
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Draws text on a terminal, so that a test can be read.
    fn drawn(text: &str) -> Vec<String> {
        let ink = ink(text);
        let row = |y| {
            (0..width(text))
                .map(|x| if ink.contains(&(x, y)) { '#' } else { '.' })
                .collect()
        };
        (0..GLYPH_ROWS).map(row).collect()
    }

    #[test]
    fn letters_stand_on_the_baseline_one_column_apart() {
        let expected = [
            "#.....#......",
            "#............",
            "#.....#.####.",
            "#.....#.#...#",
            "#.....#.#...#",
            "#.....#.#...#",
            "#####.#.####.",
            "........#....",
            "........#....",
        ];
        assert_eq!(drawn("Lip"), expected);
        assert_eq!(width("L p"), 5 + 1 + SPACE + 1 + 5);
    }

    #[test]
    fn every_printable_character_but_the_space_has_its_own_ink_within_its_cell() {
        let glyphs: std::collections::BTreeSet<Vec<(usize, usize)>> =
            ('!'..='~').map(|c| glyph(c).collect()).collect();
        assert_eq!(glyphs.len(), 94);
        assert!(glyphs.iter().flatten().all(|&(x, _)| x < CELL - 1));
        assert!(SHEET.iter().all(|row| row.len() == 16 * CELL));
    }

    #[test]
    fn what_the_font_lacks_shows_as_a_question_mark() {
        assert_eq!(drawn("\u{e9}"), drawn("?"));
    }
}
