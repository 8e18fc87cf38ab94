//! Rotation of a deformation gradient.

use glam::{DMat3, DVec3};

/// Most Jacobi sweeps; four to six suffice for every gradient.
const SWEEPS: usize = 16;

/// Relative tolerance of the scalar product of orthogonal columns.
const ORTHOGONAL: f64 = f64::EPSILON;

/// Singular value, relative to the largest, below which the direction is undefined.
const NO_DIRECTION: f64 = 1e-15;

/// The proper rotation (determinant +1) nearest to F in the Frobenius norm.
///
/// R = U V^T of the singular value decomposition F = U S V^T, with the direction of the smallest singular value reversed if det
/// F < 0. There the polar factor F (F^T F)^(-1/2) of (thesis, 3.58) is a reflection; for det F = 0 it does not exist.
///
/// One-sided Jacobi rotations (Hestenes 1958) orthogonalise the columns of F. They preserve the relative accuracy of small
/// singular values, since F^T F is not formed. Of several nearest rotations (two equal smallest singular values with det F < 0,
/// a rank below two) the choice is deterministic. F = 0 and nonfinite F have the identity.
pub fn rotation(f: DMat3) -> DMat3 {
    let largest = f.to_cols_array().into_iter().map(f64::abs);
    let largest = largest.fold(0.0, f64::max);
    if largest == 0.0 || !f.is_finite() {
        return DMat3::IDENTITY;
    }
    let mut us = [f.x_axis, f.y_axis, f.z_axis].map(|column| column / largest);
    let mut v = DVec3::AXES;
    for _ in 0..SWEEPS {
        let mut done = true;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (pp, qq) = (us[p].length_squared(), us[q].length_squared());
            let pq = us[p].dot(us[q]);
            if pq.abs() <= ORTHOGONAL * (pp.sqrt() * qq.sqrt()) {
                continue;
            }
            done = false;
            // The smaller of the two angles that orthogonalise the columns.
            let cot_double = (qq - pp) / (2.0 * pq);
            let tan = 1.0_f64.copysign(cot_double) / (cot_double.abs() + cot_double.hypot(1.0));
            let cos = 1.0 / tan.hypot(1.0);
            let sin = cos * tan;
            for columns in [&mut us, &mut v] {
                let (a, b) = (columns[p], columns[q]);
                columns[p] = cos * a - sin * b;
                columns[q] = sin * a + cos * b;
            }
        }
        if done {
            break;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| us[b].length_squared().total_cmp(&us[a].length_squared()));
    let [first, second, _] = order;
    // The third directions complete right-handed frames: the sign of det F affects the smallest singular value.
    let v = frame(v[first], v[second]);
    let u1 = us[first].normalize();
    let u = if us[second].length() > NO_DIRECTION * us[first].length() {
        frame(u1, us[second])
    } else {
        // All rotations about u1 are equally near; this one changes the other directions least.
        let [_, v2, v3] = [v.x_axis, v.y_axis, v.z_axis];
        if v2.dot(u1).abs() <= v3.dot(u1).abs() { frame(u1, v2) } else { frame(u1, v3.cross(u1)) }
    };
    u * v.transpose()
}

/// Right-handed frame of a unit vector and a second direction.
fn frame(a: DVec3, b: DVec3) -> DMat3 {
    let b = (b.normalize() - a * a.dot(b.normalize())).normalize();
    DMat3::from_cols(a, b, a.cross(b))
}
