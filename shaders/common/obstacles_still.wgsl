#import real

// Prescribed boundary flux of static obstacles: zero, m/s.
fn taken_by_obstacles(quad: u32) -> Real4 {
    return Real4();
}
