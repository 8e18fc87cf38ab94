//! Tetrahedral meshes of solids.

use glam::DVec3;

/// Linear tetrahedra. All are positively oriented: det \[x1 - x0, x2 - x0, x3 - x0\] > 0; every node belongs to one at least.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetMesh {
    /// Positions, m.
    pub nodes: Vec<DVec3>,
    /// Node numbers.
    pub elements: Vec<[u32; 4]>,
}

impl TetMesh {
    /// Six times the signed volume of an element, m^3.
    pub fn determinant(&self, element: [u32; 4]) -> f64 {
        let [a, b, c, d] = element.map(|node| self.nodes[node as usize]);
        (b - a).cross(c - a).dot(d - a)
    }

    /// Volume of all elements, m^3.
    pub fn volume(&self) -> f64 {
        let elements = self.elements.iter();
        elements
            .map(|&element| self.determinant(element))
            .sum::<f64>()
            / 6.0
    }
}
