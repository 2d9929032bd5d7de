//! Who calls whom, and how deep the stack gets.

use std::collections::BTreeSet;

use anyhow::{Result, bail};

/// A function: what its frame takes, whom it calls.
#[derive(Clone, Debug, Default)]
pub struct Node {
    pub name: String,
    pub frame_bytes: u64,
    pub calls: BTreeSet<usize>,
    /// Calls through a register.
    pub indirect_calls: usize,
    /// Functions whose address its code makes.
    pub points_to: BTreeSet<usize>,
}

#[derive(Default)]
pub struct Graph {
    pub nodes: Vec<Node>,
}

/// The deepest way down from a function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bound {
    pub bytes: u64,
    /// The functions on it, outermost first.
    pub way: Vec<usize>,
}

impl Graph {
    /// All that `root` may call, itself included; nothing beyond functions of which `ends` is true.
    pub fn reach(&self, root: usize, ends: &dyn Fn(&Node) -> bool) -> BTreeSet<usize> {
        let mut seen = BTreeSet::new();
        let mut open = vec![root];
        while let Some(node) = open.pop() {
            if seen.insert(node) && (node == root || !ends(&self.nodes[node])) {
                open.extend(&self.nodes[node].calls);
            }
        }
        seen
    }

    /// The most that `root` and all below take of the stack; a call at the end of a function counts like any
    /// other. Functions of which `ends` is true count as nothing. Recursion is an error.
    pub fn bound(&self, root: usize, ends: &dyn Fn(&Node) -> bool) -> Result<Bound> {
        self.deepest(root, ends, &mut Vec::new(), &mut vec![None; self.nodes.len()])
    }

    /// From now on take `node` and all below it for one function. Should something below it call it again, that
    /// second time takes its frame only: for functions that see to it that they go no deeper.
    pub fn seal(&mut self, node: usize) -> Result<()> {
        let again = self.nodes.len();
        self.nodes.push(Node { calls: BTreeSet::new(), ..self.nodes[node].clone() });
        self.redirect(node, again);
        let bytes = self.bound(node, &|_| false).map(|bound| bound.bytes);
        self.redirect(again, node);
        self.nodes.pop();
        let sealed = &mut self.nodes[node];
        (sealed.frame_bytes, sealed.calls) = (bytes?, BTreeSet::new());
        Ok(())
    }

    fn redirect(&mut self, from: usize, to: usize) {
        for node in &mut self.nodes {
            if node.calls.remove(&from) {
                node.calls.insert(to);
            }
        }
    }

    /// `above`: who leads to `node`; `known`: bounds that were found before.
    fn deepest(
        &self,
        node: usize,
        ends: &dyn Fn(&Node) -> bool,
        above: &mut Vec<usize>,
        known: &mut [Option<Bound>],
    ) -> Result<Bound> {
        if let Some(bound) = &known[node] {
            return Ok(bound.clone());
        }
        if let Some(start) = above.iter().position(|&caller| caller == node) {
            let ring: Vec<_> = above[start..].iter().map(|&node| self.nodes[node].name.as_str()).collect();
            bail!("recursion, so the stack has no bound: {} -> itself", ring.join(" -> "));
        }
        let this = &self.nodes[node];
        let mut deepest = Bound { bytes: 0, way: Vec::new() };
        above.push(node);
        for &call in this.calls.iter().filter(|&&call| !ends(&self.nodes[call])) {
            let below = self.deepest(call, ends, above, known)?;
            if deepest.way.is_empty() || below.bytes > deepest.bytes {
                deepest = below;
            }
        }
        above.pop();
        let way = [&[node], &deepest.way[..]].concat();
        let bound = Bound { bytes: this.frame_bytes + deepest.bytes, way };
        known[node] = Some(bound.clone());
        Ok(bound)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(nodes: &[(&str, u64, &[usize])]) -> Graph {
        let node = |&(name, frame_bytes, calls): &(&str, u64, &[usize])| Node {
            name: name.to_owned(),
            frame_bytes,
            calls: calls.iter().copied().collect(),
            ..Node::default()
        };
        Graph { nodes: nodes.iter().map(node).collect() }
    }

    #[test]
    fn the_deepest_way_counts_not_the_longest() {
        let graph = graph(&[("main", 8, &[1, 3]), ("a", 16, &[2]), ("b", 16, &[]), ("big", 100, &[])]);
        let bound = graph.bound(0, &|_| false).unwrap();
        assert_eq!(bound, Bound { bytes: 108, way: vec![0, 3] });
        assert_eq!(graph.reach(1, &|_| false).into_iter().collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn recursion_is_an_error_that_names_the_ring() {
        let graph = graph(&[("main", 8, &[1]), ("a", 16, &[2]), ("b", 16, &[1])]);
        let error = graph.bound(0, &|_| false).unwrap_err().to_string();
        assert!(error.ends_with("a -> b -> itself"), "{error}");
    }

    #[test]
    fn ends_count_as_nothing() {
        let graph = graph(&[("main", 8, &[1]), ("panic", 16, &[2]), ("fmt", 1000, &[2])]);
        let ends = |node: &Node| node.name == "panic";
        assert_eq!(graph.bound(0, &ends).unwrap().bytes, 8);
        assert!(!graph.reach(0, &ends).contains(&2));
    }

    #[test]
    fn a_sealed_function_may_be_entered_once_more() {
        // What panics logs, and what logs may panic.
        let mut graph = graph(&[("main", 8, &[1, 2]), ("panic", 16, &[2]), ("log", 100, &[1])]);
        assert!(graph.bound(0, &|_| false).is_err());
        graph.seal(1).unwrap();
        assert_eq!(graph.nodes.len(), 3);
        assert_eq!(graph.nodes[1].frame_bytes, 16 + 100 + 16);
        assert_eq!(graph.bound(0, &|_| false).unwrap().bytes, 8 + 100 + 132);
    }
}
