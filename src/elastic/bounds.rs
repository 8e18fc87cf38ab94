//! Bounds of the eigenvalues of assembled matrices from those of the elements: x^T S x is the sum over elements of
//! x_e^T S_e x_e, so an inequality that holds in every element holds for the sum (Fried 1972). Rotation, pins and time steps
//! change none of them: they are computed once.

use glam::{DMat3, DVec3};
use rayon::prelude::*;

use super::{Body, Solids, stiffness_block};

/// Squarings of the matrix whose trace bounds its largest eigenvalue: from above by at most 6^(1/1024) - 1 = 0.18 %.
const SQUARINGS: u32 = 10;

/// Rounding of all this, generously.
const ROUNDING: f64 = 1.0 + 1e-9;

/// Chebyshev polynomials have at least and at most this degree.
const DEGREES: [f64; 2] = [8.0, 64.0];

/// Bounds from above.
#[derive(Clone, Debug, PartialEq)]
pub struct Bounds {
    /// Of the eigenvalues of D^-1 S, where S = zeta_M M + zeta_K K for any positive zeta_M, zeta_K and any rotations, and D are
    /// the 3x3 blocks on its diagonal; also with prescribed components left out.
    pub block_jacobi: f64,
    /// Of the eigenvalues of M^-1 K of each body, 1/s^2: squares of the angular frequencies of its lumped mesh.
    pub frequency_squared: Vec<f64>,
}

impl Bounds {
    /// The bounds of all solids.
    pub fn new(solids: &Solids) -> Bounds {
        let of_body = |body: &Body| -> [f64; 2] {
            let elements = body.elements.clone().into_par_iter();
            let bounds = elements.map(|element| {
                let gradients = &solids.gradients[element];
                [
                    largest_eigenvalue(body, gradients, |g| {
                        stiffness_block(g, g, body.lambda, body.mu).inverse()
                    }),
                    // A quarter of the element's mass, over its volume.
                    largest_eigenvalue(body, gradients, |_| {
                        DMat3::from_diagonal(DVec3::splat(4.0 / body.density))
                    }),
                ]
            });
            bounds.reduce(|| [0.0; 2], |[a, b], [c, d]| [a.max(c), b.max(d)])
        };
        let bounds: Vec<[f64; 2]> = solids.bodies.iter().map(of_body).collect();
        let largest = bounds.iter().map(|[block_jacobi, _]| *block_jacobi);
        Bounds {
            // Mass alone has 1.
            block_jacobi: largest.fold(1.0, f64::max),
            frequency_squared: bounds.into_iter().map(|[_, square]| square).collect(),
        }
    }

    /// Degree of the Chebyshev polynomial in D^-1 S for a step of dt (s): ceil(sqrt(zeta_K lmax(M^-1 K) / zeta_M)), within 8
    /// and 64.
    pub fn chebyshev_degree(&self, solids: &Solids, dt: f64) -> usize {
        self.chebyshev_degree_for(solids, |body| [body.zeta_mass(dt), body.zeta_stiffness(dt)])
    }

    /// The same for other zeta_M (1/s) and zeta_K (s).
    pub fn chebyshev_degree_for(&self, solids: &Solids, zeta: impl Fn(&Body) -> [f64; 2]) -> usize {
        let [least, most] = DEGREES;
        let wanted = self.wanted_degree_for(solids, zeta);
        wanted.max(least).min(most).ceil() as usize
    }

    /// The degree before its limits: sqrt(zeta_K lmax(M^-1 K) / zeta_M), the largest of all solids.
    pub fn wanted_degree_for(&self, solids: &Solids, zeta: impl Fn(&Body) -> [f64; 2]) -> f64 {
        let wanted = solids.bodies.iter().zip(&self.frequency_squared);
        let wanted = wanted.map(|(body, square)| {
            let [mass, stiffness] = zeta(body);
            (stiffness * square / mass).sqrt()
        });
        wanted.fold(0.0, f64::max)
    }
}

/// Largest eigenvalue of D^-1 K_e / V, from above; D is diagonal in blocks, and `inverse` gives those of D^-1 from the gradients.
///
/// With an orthonormal basis s_k of the symmetric tensors, K_e / V = G^T C G, where G_k(a, .) = s_k g_a and C = 2 mu I +
/// lambda tr tr^T. D^-1 G^T C G has the same eigenvalues but zeros as the 6x6 matrix A = C (G D^-1 G^T), all of them real and
/// positive, so lmax <= (tr A^n)^(1/n).
fn largest_eigenvalue(
    body: &Body,
    gradients: &[DVec3; 4],
    inverse: impl Fn(DVec3) -> DMat3,
) -> f64 {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let tensor = |i: usize, j: usize, value: f64| {
        let mut columns = [[0.0; 3]; 3];
        columns[i][j] = value;
        columns[j][i] = value;
        DMat3::from_cols_array_2d(&columns)
    };
    let basis = [
        tensor(0, 0, 1.0),
        tensor(1, 1, 1.0),
        tensor(2, 2, 1.0),
        tensor(1, 2, half),
        tensor(0, 2, half),
        tensor(0, 1, half),
    ];
    let mut product = [[0.0; 6]; 6];
    for &gradient in gradients {
        let inverse = inverse(gradient);
        let strains = basis.map(|tensor| tensor * gradient);
        for (row, a) in product.iter_mut().zip(strains) {
            for (entry, b) in row.iter_mut().zip(strains) {
                *entry += a.dot(inverse * b);
            }
        }
    }
    let volumetric: [f64; 6] =
        std::array::from_fn(|column| (0..3).map(|row| product[row][column]).sum());
    for (k, row) in product.iter_mut().enumerate() {
        for (entry, sum) in row.iter_mut().zip(volumetric) {
            *entry = 2.0 * body.mu * *entry + if k < 3 { body.lambda * sum } else { 0.0 };
        }
    }
    // The logarithm of what the matrix was divided by, per factor of the product.
    let mut logarithm = 0.0;
    let mut share = 1.0;
    for _ in 0..SQUARINGS {
        let trace: f64 = (0..6).map(|k| product[k][k]).sum();
        logarithm += share * trace.ln();
        let scaled = product.map(|row| row.map(|entry| entry / trace));
        product = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..6).map(|k| scaled[i][k] * scaled[k][j]).sum())
        });
        share *= 0.5;
    }
    let trace: f64 = (0..6).map(|k| product[k][k]).sum();
    (logarithm + share * trace.ln()).exp() * ROUNDING
}
