#import pair
#import real

// Projects a free node beyond a domain wall onto it and removes its velocity into it.
struct Stopped {
    displacement: Pair,
    velocity: Real3,
    stopped: bool,
}

fn out_of_walls(rest_position: vec3<f32>, free: vec3<bool>, u: Pair, v: Real3, size: vec3<f32>, zero: u32) -> Stopped {
    let x = Real3(rest_position) + pair_value(u);
    let low = free & (x < Real3());
    let high = free & (x > Real3(size));
    let beyond = low | high;
    let wall = select(vec3<f32>(), size, high);
    let on_wall = pair_plus(Pair(-rest_position, vec3<f32>()), Real3(wall), zero);
    let put = Pair(select(u.hi, on_wall.hi, beyond), select(u.lo, on_wall.lo, beyond));
    return Stopped(put, select(select(v, max(v, Real3()), low), min(v, Real3()), high), any(beyond));
}
