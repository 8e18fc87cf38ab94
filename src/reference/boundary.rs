//! Boundary of the liquid on the grid: obstacles and immersed solids.

use crate::elastic::Solids;
use crate::geometry::{CutCells, ObstacleCut, SolidClip};
use crate::scene::Scene;

/// Cut cells of the obstacles and solids of a scene.
#[derive(Clone, Debug)]
pub(super) enum Boundary {
    /// Obstacles at rest.
    Fixed(CutCells),
    /// Immersed solids, or obstacles in motion.
    Moving(Box<SolidClip>),
}

impl Boundary {
    /// Open areas of the faces and distances of the cells, now.
    pub(super) fn cut_cells(&self) -> &CutCells {
        match self {
            Boundary::Fixed(cut) => cut,
            Boundary::Moving(clip) => clip.cut_cells(),
        }
    }

    pub(super) fn clip(&self) -> Option<&SolidClip> {
        match self {
            Boundary::Fixed(_) => None,
            Boundary::Moving(clip) => Some(clip),
        }
    }

    /// Copies the keyframes of a scene's obstacles.
    pub(super) fn follow(&mut self, scene: &Scene) {
        if let Boundary::Moving(clip) = self {
            clip.follow(scene);
        }
    }

    pub(super) fn moving_obstacles(&self) -> Option<&ObstacleCut> {
        self.clip().map(SolidClip::obstacles)
    }

    /// Moves the obstacles to a time, with the mean velocities of the next dt (both s), and clips solids with a displacement (m).
    pub(super) fn update(&mut self, solids: Option<&Solids>, displacement: &[[f64; 3]], time: f64, dt: f64) {
        if let Boundary::Moving(clip) = self {
            clip.move_obstacles(time, dt);
            if let Some(solids) = solids {
                clip.clip(&solids.moved(displacement));
            }
        }
    }
}
