//! Into which shares a product is cut: by how much all of them read. It knows no values.

use super::tile::{COLUMNS, ROWS};
use crate::runtime::cpu::share::Cut;

/// The fewest panels per task: a tile of the left factor meets them all.
const NARROWEST: usize = 2;
/// The most: packed, they stay in the second cache.
const PANELS: usize = 8;
/// Tasks are made smaller until there are about so many, whatever the number of threads.
const TASKS: usize = 16;
/// The fewest rows of a task: enough to make packing cheap.
const FEWEST_ROWS: usize = 8 * ROWS;
/// The most rows of a task.
const MOST_ROWS: usize = 64 * ROWS;

/// The cut whose shares read and pack least. Narrow shares read the left factor more often, and low
/// ones pack the right factor more often; to pack a number costs `packing` times what it costs to
/// read one of the left factor. A share has at most 256 columns, and as few rows as it takes for
/// enough tasks.
pub fn cut(extents: [usize; 3], packing: usize) -> Cut {
    let narrowest = with_panels(extents, NARROWEST);
    let work = |cut: &Cut| {
        let packed = cut.matrices * cut.panels_per_matrix() * COLUMNS * packing;
        cut.rows * cut.shares_across() + packed * cut.shares_down()
    };
    (NARROWEST + 1..=PANELS)
        .map(|panels| with_panels(extents, panels))
        // Where even the narrowest are fewer tasks, that is as many as there can be.
        .filter(|cut| cut.shares_across() * cut.shares_down() >= TASKS)
        .fold(
            narrowest,
            |best, cut| if work(&cut) < work(&best) { cut } else { best },
        )
}

/// The cut into shares of so many panels.
fn with_panels([matrices, rows, columns]: [usize; 3], share_panels: usize) -> Cut {
    let panels = (matrices * columns.div_ceil(COLUMNS)).max(1);
    // As many shares down as leave TASKS of them with these panels.
    let down = TASKS
        .div_ceil(panels.div_ceil(share_panels))
        .max(rows.div_ceil(MOST_ROWS));
    let share_rows = rows.div_ceil(down).next_multiple_of(ROWS).max(FEWEST_ROWS);
    Cut {
        matrices,
        rows,
        columns,
        panel: COLUMNS,
        share_rows,
        share_panels,
    }
}
