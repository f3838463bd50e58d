//! The commands that a simulator sees, averaged over the parts of past blocks.

use engine::Lane;

/// Scaled commands of a shard, averaged over the parts of each block; before the breath they have their rest values.
#[derive(Clone, Debug)]
pub struct CommandLog {
    width: usize,
    rest: Vec<Lane>,
    values: Vec<Lane>,
}

impl CommandLog {
    /// An empty log of `blocks` blocks; `rest` contains the values before the breath, one per place in a block.
    pub fn new(blocks: usize, rest: Vec<Lane>) -> Self {
        let width = rest.len();
        Self { width, rest, values: vec![Lane::ZERO; blocks * width] }
    }

    /// Values of a block; the rest values for blocks before the breath.
    pub fn block(&self, block: Option<usize>) -> &[Lane] {
        match block {
            Some(block) => &self.values[block * self.width..(block + 1) * self.width],
            None => &self.rest,
        }
    }

    /// Mutable access to the values of a block.
    pub fn block_mut(&mut self, block: usize) -> &mut [Lane] {
        &mut self.values[block * self.width..(block + 1) * self.width]
    }

    /// Clears the log for a breath before which all commands were `rest`.
    pub fn reset(&mut self, rest: Lane) {
        self.rest.fill(rest);
        self.values.fill(Lane::ZERO);
    }

    /// Copies the `history` blocks up to and including `newest` into `out`, newest first.
    pub(crate) fn gather(&self, newest: Option<usize>, history: usize, out: &mut [Lane]) {
        for (age, out) in out.chunks_exact_mut(self.width).take(history).enumerate() {
            out.copy_from_slice(self.block(newest.and_then(|block| block.checked_sub(age))));
        }
    }

    /// The reverse of [`Self::gather`] for gradients: adds `d` to the blocks from which it was gathered.
    pub(crate) fn scatter(&mut self, newest: Option<usize>, d: &[Lane]) {
        for (age, d) in d.chunks_exact(self.width).enumerate() {
            let Some(block) = newest.and_then(|block| block.checked_sub(age)) else {
                continue;
            };
            for (value, d) in self.block_mut(block).iter_mut().zip(d) {
                value.add_scaled(1.0, d);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_is_at_rest_before_the_breath() {
        let mut log = CommandLog::new(3, vec![Lane::splat(0.1), Lane::splat(0.2)]);
        log.block_mut(0).fill(Lane::splat(7.0));
        let mut seen = vec![Lane::ZERO; 4];
        log.gather(Some(0), 2, &mut seen);
        assert_eq!(
            [seen[0][0], seen[1][0], seen[2][0], seen[3][0]].map(|x| (x * 10.0) as i32),
            [70, 70, 1, 2]
        );
    }
}
