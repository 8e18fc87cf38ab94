//! The rotation of a deformation gradient.

use glam::{DMat3, DVec3};

/// Sweeps of the Jacobi rotations at most; four to six do, whatever the gradient.
const SWEEPS: usize = 16;

/// Columns are orthogonal when their scalar product is below this times their lengths.
const ORTHOGONAL: f64 = f64::EPSILON;

/// A singular value below this part of the largest has no direction.
const NO_DIRECTION: f64 = 1e-15;

/// The proper rotation (determinant +1) that is nearest to F in the Frobenius norm: R = U V^T of the singular value decomposition
/// F = U S V^T with the direction of the smallest singular value turned round where det F < 0. The polar factor
/// F (F^T F)^(-1/2) of (thesis, 3.58) would be a reflection there, and does not exist where det F = 0.
///
/// The columns of F are rotated against each other until they are orthogonal (one-sided Jacobi, Hestenes 1958), which keeps small
/// singular values to their own digits: F^T F is not formed. Where several rotations are equally near (the two smallest
/// singular values equal with det F < 0, a rank below two) one of them is returned, always the same; the identity for F = 0
/// and for numbers that are not finite.
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
            // The smaller of the two angles that make them orthogonal.
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
    // Third directions that complete right-handed frames put the sign of det F where it costs least.
    let v = frame(v[first], v[second]);
    let u1 = us[first].normalize();
    let u = if us[second].length() > NO_DIRECTION * us[first].length() {
        frame(u1, us[second])
    } else {
        // Every turn about u1 is as near: one that leaves the other directions about where they are.
        let [_, v2, v3] = [v.x_axis, v.y_axis, v.z_axis];
        if v2.dot(u1).abs() <= v3.dot(u1).abs() {
            frame(u1, v2)
        } else {
            frame(u1, v3.cross(u1))
        }
    };
    u * v.transpose()
}

/// The right-handed frame of a unit vector and the direction of another.
fn frame(a: DVec3, b: DVec3) -> DMat3 {
    let b = (b.normalize() - a * a.dot(b.normalize())).normalize();
    DMat3::from_cols(a, b, a.cross(b))
}
