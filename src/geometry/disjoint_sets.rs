//! Disjoint sets (union-find) with path halving.

/// A partition of the numbers from 0.
pub(crate) struct DisjointSets {
    parents: Vec<u32>,
}

impl DisjointSets {
    /// `n` sets of one number each.
    pub(crate) fn new(n: usize) -> DisjointSets {
        DisjointSets { parents: (0..n as u32).collect() }
    }

    /// The least number of a set.
    fn root(&mut self, mut number: u32) -> u32 {
        while self.parents[number as usize] != number {
            let parent = self.parents[number as usize];
            self.parents[number as usize] = self.parents[parent as usize];
            number = self.parents[number as usize];
        }
        number
    }

    pub(crate) fn merge(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }

    /// The set of each number, counted in the order of their least numbers, and how many sets there are.
    pub(crate) fn labels(mut self) -> (Vec<u32>, usize) {
        let mut labels = vec![0; self.parents.len()];
        let mut n = 0;
        for number in 0..self.parents.len() as u32 {
            let root = self.root(number);
            labels[number as usize] = if root == number {
                n += 1;
                n - 1
            } else {
                labels[root as usize]
            };
        }
        (labels, n as usize)
    }
}
