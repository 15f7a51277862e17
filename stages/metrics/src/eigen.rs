//! Eigenvalues of small symmetric matrices by Jacobi rotations, and the pseudo-inverse made of
//! them. Knows nothing of what the matrix means; meant for tens of rows, not thousands.

/// Sweeps after which a matrix counts as diagonal whatever is left; 36 rows need about eight.
const MAX_SWEEPS: usize = 60;

/// `matrix = sum_i values[i] * vectors[i] vectors[i]^T`, in no particular order.
pub(crate) struct Eigen {
    pub values: Vec<f64>,
    /// Orthonormal, one per eigenvalue.
    pub vectors: Vec<Vec<f64>>,
}

/// Eigenvalues and vectors of a symmetric matrix given by rows. The order of rotations is fixed.
pub(crate) fn eigen(mut matrix: Vec<Vec<f64>>) -> Eigen {
    let n = matrix.len();
    let mut vectors: Vec<Vec<f64>> = (0..n)
        .map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect())
        .collect();
    for _ in 0..MAX_SWEEPS {
        let mut rotated = false;
        for p in 0..n {
            // Row by row and not by size: the same matrix gives the same bits.
            for q in p + 1..n {
                rotated |= rotate(&mut matrix, &mut vectors, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    Eigen {
        values: (0..n).map(|i| matrix[i][i]).collect(),
        vectors,
    }
}

/// `d^T pinv(matrix) d`. Eigenvalues below `1e-15` of the largest count as zero, as numpy's `pinv`
/// has it.
pub(crate) fn pinv_quadratic_form(matrix: Vec<Vec<f64>>, d: &[f64]) -> f64 {
    let Eigen { values, vectors } = eigen(matrix);
    let largest = values
        .iter()
        .fold(0.0f64, |largest, value| largest.max(value.abs()));
    // Relative to the largest, so that scaling the matrix drops neither more nor fewer directions.
    let kept = values
        .iter()
        .zip(&vectors)
        .filter(|(value, _)| value.abs() > 1e-15 * largest);
    kept.map(|(value, vector)| dot(vector, d).powi(2) / value)
        .sum()
}

/// Whether entry (p, q) is too small to move either eigenvalue by a bit.
fn negligible(matrix: &[Vec<f64>], p: usize, q: usize) -> bool {
    let entry = matrix[p][q].abs();
    entry <= f64::MIN_POSITIVE || entry <= 1e-17 * (matrix[p][p] * matrix[q][q]).abs().sqrt()
}

/// One rotation in the plane (p, q) that brings entry (p, q) to zero (Golub and Van Loan, 8.5.2),
/// if there is need.
fn rotate(matrix: &mut [Vec<f64>], vectors: &mut [Vec<f64>], p: usize, q: usize) -> bool {
    if negligible(matrix, p, q) {
        return false;
    }
    // cot of twice the angle; of both roots for its tangent the smaller one, which turns the least.
    let theta = (matrix[q][q] - matrix[p][p]) / (2.0 * matrix[p][q]);
    // By `hypot`, since theta^2 overflows for tiny entries; signum(0) is 1, a turn by 45 degrees.
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    // Q^T A Q: columns first, then rows.
    for row in matrix.iter_mut() {
        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
    }
    rotate_rows(matrix, p, q, c, s);
    // Eigenvectors lie in rows, so a turn of their columns is one of rows.
    rotate_rows(vectors, p, q, c, s);
    true
}

fn rotate_rows(rows: &mut [Vec<f64>], p: usize, q: usize, c: f64, s: f64) {
    for i in 0..rows[p].len() {
        (rows[p][i], rows[q][i]) = (
            c * rows[p][i] - s * rows[q][i],
            s * rows[p][i] + c * rows[q][i],
        );
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A symmetric matrix without structure: 36 rows of residues.
    fn residues(n: usize) -> Vec<Vec<f64>> {
        let entry = |i: usize, j: usize| ((i * j * 31 + i + j) % 17) as f64 - 8.0;
        (0..n)
            .map(|i| (0..n).map(|j| entry(i, j)).collect())
            .collect()
    }

    #[test]
    fn two_by_two_is_the_schoolbook_case() {
        let Eigen { mut values, .. } = eigen(vec![vec![2.0, 1.0], vec![1.0, 2.0]]);
        values.sort_by(f64::total_cmp);
        assert!(
            (values[0] - 1.0).abs() < 1e-15 && (values[1] - 3.0).abs() < 1e-15,
            "{values:?}"
        );
    }

    #[test]
    fn values_and_vectors_give_the_matrix_back() {
        let matrix = residues(36);
        let Eigen { values, vectors } = eigen(matrix.clone());
        for i in 0..36 {
            for j in 0..36 {
                let entry: f64 = (0..36)
                    .map(|k| values[k] * vectors[k][i] * vectors[k][j])
                    .sum();
                assert!(
                    (entry - matrix[i][j]).abs() < 1e-12,
                    "({i}, {j}): {entry} is not {}",
                    matrix[i][j]
                );
                let product = dot(&vectors[i], &vectors[j]);
                assert!(
                    (product - f64::from(u8::from(i == j))).abs() < 1e-13,
                    "vectors {i}, {j}: {product}"
                );
            }
        }
    }

    /// diag(4, 1e-20) has rank one to working precision: the second direction is dropped, not
    /// divided by 1e-20.
    #[test]
    fn the_pseudo_inverse_ignores_what_the_matrix_does_not_span() {
        let form = pinv_quadratic_form(vec![vec![4.0, 0.0], vec![0.0, 1e-20]], &[2.0, 5.0]);
        assert_eq!(form, 1.0);
        let form = pinv_quadratic_form(vec![vec![1.0, 1.0], vec![1.0, 1.0]], &[1.0, 1.0]);
        assert!((form - 1.0).abs() < 1e-14, "{form}");
    }
}
