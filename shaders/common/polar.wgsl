// The proper rotation (determinant +1) nearest to a matrix in the Frobenius norm: U V^T of the singular value
// decomposition U S V^T, with the direction of the smallest singular value reversed if the determinant is negative.
//
// One-sided Jacobi (Hestenes 1958) rotates the columns until they are orthogonal. It avoids the matrix times its
// transpose, whose condition number is squared. The third directions of U and V complete right-handed frames, so the
// result is proper for any matrix. Its error is a few EPSILON (1 + s1 / (s2 +- s3)), - where inverted.
#import real

// Four to six are sufficient.
const SWEEPS = 8;
// A smaller matrix counts as zero and yields the identity.
const SMALLEST_MATRIX = Real(1e-30);
// Second singular values below this part of the first, in EPSILON, have no direction.
const NO_DIRECTION = Real(16.0);

fn identity() -> Real3x3 {
    let one = Real(1.0);
    let zero = Real();
    return Real3x3(one, zero, zero, zero, one, zero, zero, zero, one);
}

fn unit(a: Real3) -> Real3 {
    return a / sqrt(dot(a, a));
}

// Component of a orthogonal to a unit vector.
fn without(a: Real3, direction: Real3) -> Real3 {
    return a - dot(a, direction) * direction;
}

// Rotates columns a and b, and p and q with them, until a and b are orthogonal. The smaller of the two angles.
fn orthogonalise(a: ptr<function, Real3>, b: ptr<function, Real3>, p: ptr<function, Real3>, q: ptr<function, Real3>) -> bool {
    let aa = dot(*a, *a);
    let bb = dot(*b, *b);
    let ab = dot(*a, *b);
    if !(abs(ab) > EPSILON * sqrt(aa) * sqrt(bb)) {
        return false;
    }
    let one = Real(1.0);
    let cot_double = (bb - aa) / (Real(2.0) * ab);
    let tangent = select(one, -one, cot_double < Real()) / (abs(cot_double) + sqrt(one + cot_double * cot_double));
    let cosine = one / sqrt(one + tangent * tangent);
    let sine = cosine * tangent;
    let turned = cosine * *a - sine * *b;
    *b = sine * *a + cosine * *b;
    *a = turned;
    let turned_frame = cosine * *p - sine * *q;
    *q = sine * *p + cosine * *q;
    *p = turned_frame;
    return true;
}

// Moves the longer of two columns to the front by a quarter turn, with those of the frame.
fn order(a: ptr<function, Real3>, b: ptr<function, Real3>, p: ptr<function, Real3>, q: ptr<function, Real3>) {
    if dot(*a, *a) < dot(*b, *b) {
        let longer = *b;
        *b = -*a;
        *a = longer;
        let direction = *q;
        *q = -*p;
        *p = direction;
    }
}

fn nearest_rotation(f: Real3x3) -> Real3x3 {
    let one = identity();
    let magnitude = max(max(abs(f[0]), abs(f[1])), abs(f[2]));
    let largest = max(max(magnitude.x, magnitude.y), magnitude.z);
    if !(largest > SMALLEST_MATRIX) {
        return one;
    }
    var a = f[0] / largest;
    var b = f[1] / largest;
    var c = f[2] / largest;
    var p = one[0];
    var q = one[1];
    var r = one[2];
    for (var sweep = 0; sweep < SWEEPS; sweep++) {
        let ab = orthogonalise(&a, &b, &p, &q);
        let ac = orthogonalise(&a, &c, &p, &r);
        let bc = orthogonalise(&b, &c, &q, &r);
        if !(ab || ac || bc) {
            break;
        }
    }
    order(&a, &b, &p, &q);
    order(&a, &c, &p, &r);
    order(&b, &c, &q, &r);
    let v1 = unit(p);
    let v2 = unit(without(q, v1));
    let v3 = cross(v1, v2);
    let u1 = unit(a);
    var second = without(b, u1);
    let least = NO_DIRECTION * EPSILON;
    if !(dot(second, second) > least * least * dot(a, a)) {
        // All rotations about u1 are equally near; this one changes the other directions least.
        second = without(v2, u1);
        if abs(dot(v2, u1)) > abs(dot(v3, u1)) {
            second = cross(v3, u1);
        }
    }
    let u2 = unit(second);
    let rotation = Real3x3(u1, u2, cross(u1, u2)) * transpose(Real3x3(v1, v2, v3));
    // Rounding leaves it slightly non-orthogonal: one Newton-Schulz step.
    let defect = one - transpose(rotation) * rotation;
    return rotation + rotation * (Real(0.5) * defect);
}
