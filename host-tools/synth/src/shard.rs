//! A part of the episodes, made or judged by one of several processes.

/// Part `number` of `of`: every `of`-th episode, beginning with the `number`-th.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    number: usize,
    of: usize,
}

impl Shard {
    /// `I-of-N`, as in the name of a file.
    pub fn file_part(self) -> String {
        format!("{}-of-{}", self.number, self.of)
    }

    /// All parts of the whole.
    pub fn all(self) -> impl Iterator<Item = Self> {
        (1..=self.of).map(move |number| Self { number, of: self.of })
    }

    pub const WHOLE: Self = Self { number: 1, of: 1 };

    pub fn parse(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
        match numbers {
            Some((number, of)) if (1..=of).contains(&number) => Ok(Self { number, of }),
            Some((_, of)) if of > 0 => Err(format!("must be from 1/{of} to {of}/{of}")),
            _ => Err("must be I/N, part I of N, as 2/3".to_owned()),
        }
    }

    pub fn has(self, index: usize) -> bool {
        index % self.of == self.number - 1
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::Shard;

    #[test]
    fn shards_share_out_all_episodes() {
        for of in 1..=5 {
            let shards: Vec<_> = (1..=of).map(|i| Shard::parse(&format!("{i}/{of}")).unwrap()).collect();
            for index in 0..12 {
                assert_eq!(shards.iter().filter(|shard| shard.has(index)).count(), 1, "{index} of {of}");
            }
        }
    }
}
