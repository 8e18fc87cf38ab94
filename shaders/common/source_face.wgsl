// A face of a cell of a source: fields::DeviceSourceFace is the same struct on the host.
#import source_step

struct SourceFace {
    // Index among the faces of all axes, device layout.
    face: u32,
    // Sources of the cells on the minus side (low byte) and on the plus side; 255 for none.
    sides: u32,
    // Their velocities along the axis, m/s.
    minus: f32,
    plus: f32,
    // Shares of the face that they emit through where the other side is no source.
    minus_aperture: f32,
    plus_aperture: f32,
    pad_0: u32,
    pad_1: u32,
}

// The velocity that a face carries, m/s, if it does, and the share of the face that lets it through.
struct Held {
    is: bool,
    velocity: f32,
    aperture: f32,
}

// Between cells of sources their velocity, else that out of the source; into it nothing flows.
fn held(face: SourceFace, running: u32) -> Held {
    let minus = runs(face.sides & 255u, running);
    let plus = runs(face.sides >> 8u, running);
    let velocity = select(min(face.plus, 0.0), max(face.minus, 0.0), minus);
    let aperture = select(face.plus_aperture, face.minus_aperture, minus);
    let inner = minus && plus;
    return Held(minus || plus, select(velocity, face.minus, inner), select(aperture, 1.0, inner));
}
