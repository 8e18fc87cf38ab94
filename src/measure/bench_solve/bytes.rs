//! Bytes that solves with liquid must move: every array that a pass needs, once.

use crate::scene::Preconditioner;

use super::super::solid_bytes::SolidBytes;

/// What the corrections of a solve for liquid and solids are made of.
#[derive(Clone, Copy, Debug)]
pub(in crate::measure) enum Corrections {
    /// Pressures and velocities.
    TwoField {
        /// Of the solids' polynomial.
        degree: usize,
    },
    /// Pressures alone.
    Condensed {
        /// Nodes among which there is a dense inverse.
        wet_nodes: usize,
    },
}

/// What decides the bytes.
#[derive(Clone, Copy, Debug)]
pub(in crate::measure) struct SolveBytes {
    /// Active cells.
    pub(in crate::measure) unknowns: f64,
    /// Share of their quads whose weights are loaded.
    pub(in crate::measure) not_uniform: f64,
    /// Of conjugate gradients, in all rounds.
    pub(in crate::measure) iterations: f64,
    /// Rounds.
    pub(in crate::measure) rounds: f64,
    /// Bytes of a scalar of the corrections, and of the outer loop.
    pub(in crate::measure) widths: [f64; 2],
    /// Of the pressure, and with solids of both.
    pub(in crate::measure) preconditioner: Preconditioner,
}

impl SolveBytes {
    /// The set-up of the system of the pressure and of its hierarchy: distance and open fractions in, the matrix out.
    pub(super) fn of_set_up(&self) -> f64 {
        let [inner, _] = self.widths;
        self.unknowns * (4.0 * 4.0 + 5.0 * inner * 8.0 / 7.0)
    }

    /// A solve for the pressure, its system given. Per unknown: w bytes a scalar of the corrections, 8 of the outer loop (4 with `f32`), 5
    /// sections of the matrix for the share of quads that are not uniform; list entries, a byte per cell and pass.
    ///
    /// An iteration: apply (s, r, q), update (x and r twice, s, q, z), direction (z, s twice), preconditioner. That is a V-cycle: on the finest
    /// level two smoothing sweeps and the one after the prolongation (x, r, x_out each), restriction (x, r), prolongation (x twice), and
    /// a seventh of it on the coarser ones; or the diagonal of all quads (itself, r, z).
    pub(in crate::measure) fn of_pressure(&self) -> f64 {
        let SolveBytes {
            not_uniform,
            widths: [inner, outer],
            ..
        } = *self;
        let matrix = 5.0 * inner * not_uniform;
        let preconditioner = match self.preconditioner {
            Preconditioner::Multigrid => {
                let sweeps = 3.0 * (3.0 * inner + matrix + 1.0);
                let transfers = (2.0 * inner + matrix + 1.0) + (2.0 * inner + 1.0);
                (sweeps + transfers) * 8.0 / 7.0
            }
            Preconditioner::Jacobi | Preconditioner::BlockJacobi => 3.0 * inner + 1.0,
        };
        let rest = (3.0 * inner + matrix + 1.0)
            + (7.0 * inner + not_uniform * inner + 1.0)
            + (3.0 * inner + 1.0);
        let turn =
            (3.0 * outer + matrix + 1.0) + (2.0 * outer + inner + 1.0) + (outer + 5.0 * inner);
        self.unknowns * (self.iterations * (preconditioner + rest) + (self.rounds + 1.0) * turn)
    }

    /// A solve for the pressure and the velocities of solids, both systems given. The outer loop counts as that of the solids by
    /// themselves; what it has beside is little, as are the pairs of cells and nodes.
    pub(in crate::measure) fn of_both(&self, solids: &SolidBytes, corrections: Corrections) -> f64 {
        let iteration = match corrections {
            Corrections::TwoField { degree } => {
                solids.of_two_field(self.preconditioner, degree as f64)
            }
            // The inverse in f32, three components a node; vectors of the nodes are little beside it.
            Corrections::Condensed { wet_nodes } => 4.0 * (3.0 * wet_nodes as f64).powi(2),
        };
        self.of_pressure() + solids.of_outer_loop(self.rounds) + self.iterations * iteration
    }
}

#[cfg(test)]
mod tests {
    use super::{Corrections, SolidBytes, SolveBytes};
    use crate::reference::base_scene::{BaseBeam, BaseScene};
    use crate::scene::Preconditioner;

    const ITERATIONS: f64 = 10.0;

    /// In `mixed`, where each quad is uniform.
    fn solve(preconditioner: Preconditioner, iterations: f64) -> SolveBytes {
        SolveBytes {
            unknowns: 100.0,
            not_uniform: 0.0,
            iterations,
            rounds: 2.0,
            widths: [4.0, 8.0],
            preconditioner,
        }
    }

    /// What an iteration adds.
    fn per_iteration(preconditioner: Preconditioner, bytes: impl Fn(SolveBytes) -> f64) -> f64 {
        let [with, without] = [ITERATIONS, 0.0].map(|n| bytes(solve(preconditioner, n)));
        (with - without) / ITERATIONS
    }

    fn assert_near(found: f64, expected: f64) {
        let off = (found / expected - 1.0).abs();
        assert!(off < 1e-9, "{found}, not {expected}");
    }

    /// Apply, update and direction move 3, 7 and 3 scalars of a cell, a V-cycle 3 times 3, 2 and 2 on the finest level, a diagonal 3;
    /// each pass reads its list.
    #[test]
    fn a_diagonal_costs_less_than_a_cycle() {
        let rest = 13.0 * 4.0 + 3.0;
        let of_pressure = |kind| per_iteration(kind, |solve| solve.of_pressure());
        let cycle = (13.0 * 4.0 + 5.0) * 8.0 / 7.0;
        assert_near(
            of_pressure(Preconditioner::Multigrid),
            100.0 * (cycle + rest),
        );
        let diagonal = 3.0 * 4.0 + 1.0;
        for kind in [Preconditioner::Jacobi, Preconditioner::BlockJacobi] {
            assert_near(of_pressure(kind), 100.0 * (diagonal + rest));
        }
    }

    #[test]
    fn a_coupled_solve_counts_what_its_corrections_are_made_of() {
        let scene = BaseScene::new(12, &BaseBeam::default()).unwrap();
        let solids = SolidBytes::new(&scene.solids, [8, 4]);
        let beside_pressure = |kind, corrections| {
            let of_both = per_iteration(kind, |solve| solve.of_both(&solids, corrections));
            of_both - per_iteration(kind, |solve| solve.of_pressure())
        };
        let two_field = |kind, degree| beside_pressure(kind, Corrections::TwoField { degree });
        // A degree more is a step more of each polynomial: two with a V-cycle, one with a diagonal.
        let step = |kind| two_field(kind, 9) - two_field(kind, 8);
        let alone = |degree| solids.of_solve(degree, 1.0, 0.0);
        let one = alone(9.0) - alone(8.0);
        assert_near(step(Preconditioner::Multigrid), 2.0 * one);
        assert_near(step(Preconditioner::Jacobi), one);
        assert_near(step(Preconditioner::BlockJacobi), one);
        // The condensed form has none: an f32 for each pair of the components of 40 nodes.
        for kind in [Preconditioner::Multigrid, Preconditioner::Jacobi] {
            let condensed = beside_pressure(kind, Corrections::Condensed { wet_nodes: 40 });
            assert_near(condensed, 4.0 * 120.0 * 120.0);
            assert!(condensed < two_field(kind, 8), "{condensed}");
        }
    }
}
