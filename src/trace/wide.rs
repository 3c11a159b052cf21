//! The tree: eight boxes a node, axis by axis, collapsed from obvhs' binary tree.
//!
//! [`Cut`] says which binary nodes become wide ones. Leaves hold one [`Block`] of up to four triangles.

use glam::Vec3;
use obvhs::bvh2::{Bvh2, node::Bvh2Node};

use super::triangle::{Block, LANES};
use crate::scene::Bounds;

/// Children of a node.
pub(super) const WIDTH: usize = 8;

/// Set in a child reference that is a block, not a node.
pub(super) const LEAF: u32 = 1 << 31;

/// Eight boxes and what is in them.
#[repr(C, align(64))]
#[derive(Clone, Debug)]
pub(super) struct Node {
    /// `[axis × 2 + (0 lower, 1 upper)][child]`; a child that is not there has lower = +∞, upper = −∞.
    pub planes: [[f32; WIDTH]; 6],
    /// Index of a node, or of a block with [`LEAF`] set.
    pub children: [u32; WIDTH],
    pub n_children: u32,
}

impl Node {
    fn empty() -> Self {
        let (lower, upper) = ([f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]);
        Self {
            planes: [lower, upper, lower, upper, lower, upper],
            children: [LEAF; WIDTH],
            n_children: 0,
        }
    }

    /// The box of child `i`.
    pub fn bounds(&self, i: usize) -> Bounds {
        let p = &self.planes;
        Bounds {
            min: Vec3::new(p[0][i], p[2][i], p[4][i]),
            max: Vec3::new(p[1][i], p[3][i], p[5][i]),
        }
    }
}

/// Nodes (parents before children, root 0) and blocks in the order of the walk.
#[derive(Clone, Debug, Default)]
pub(super) struct Tree {
    pub nodes: Vec<Node>,
    pub blocks: Vec<Block>,
    /// References that a walk can have waiting at most.
    pub stack_need: usize,
}

/// Collapses `binary`, whose primitives are `triangles`; leaves hold at most [`LANES`] of them.
pub(super) fn collapse(binary: &Bvh2, triangles: &[[Vec3; 3]]) -> Tree {
    let mut tree = Tree::default();
    if binary.nodes.is_empty() {
        return tree;
    }
    let cut = Cut::new(&binary.nodes);
    // Each entry: binary subtree, and the place of its reference in a finished node.
    let mut pending = vec![(0, None)];
    while let Some((root, place)) = pending.pop() {
        let node_index = tree.nodes.len();
        if let Some((parent, slot)) = place {
            let parent: &mut Node = &mut tree.nodes[parent];
            parent.children[slot] = node_index as u32;
        }
        let mut node = Node::empty();
        let first_waiting = pending.len();
        for (slot, &child) in cut.children(&binary.nodes, root).iter().enumerate() {
            let child_node = &binary.nodes[child];
            for axis in 0..3 {
                node.planes[2 * axis][slot] = child_node.aabb.min[axis];
                node.planes[2 * axis + 1][slot] = child_node.aabb.max[axis];
            }
            node.n_children += 1;
            if child_node.is_leaf() {
                node.children[slot] = LEAF | tree.blocks.len() as u32;
                tree.blocks.push(block(binary, child_node, triangles));
            } else {
                pending.push((child, Some((node_index, slot))));
            }
        }
        pending[first_waiting..].reverse();
        tree.nodes.push(node);
    }
    tree.stack_need = stack_need(&tree.nodes);
    tree
}

/// Which binary nodes become the children of which wide one.
///
/// What a ray pays is in proportion to the surfaces of the nodes it opens: of all ways to cut the
/// binary tree into nodes of up to eight children this is the one whose surfaces have the least sum
/// (Ylitie, Karras, Laine 2017, "Efficient Incoherent Ray Traversal on GPUs", section 3.1).
struct Cut {
    /// For each inner node and each number of children 2…8 (index 0…6) that its subtree may become
    /// of a node above it (8: of its own): how many of them are its first child's. 0 says that
    /// with one fewer it is as good, for 2 that it is a node itself.
    share: Vec<[u8; WIDTH - 1]>,
}

impl Cut {
    fn new(nodes: &[Bvh2Node]) -> Self {
        let mut share = vec![[0; WIDTH - 1]; nodes.len()];
        // Least sum of surfaces below and with a node, if it may become 1…7 children; leaves have none
        let mut least = vec![[0.0_f32; WIDTH - 1]; nodes.len()];
        for &node in inner_nodes(nodes).iter().rev() {
            let first = nodes[node].first_index as usize;
            let (left, right) = (least[first], least[first + 1]);
            let divided = |places: usize| {
                let ways = (1..places).map(|n| (left[n - 1] + right[places - n - 1], n as u8));
                ways.fold((f32::INFINITY, 1), |a, b| if b.0 < a.0 { b } else { a })
            };
            let (below, own) = divided(WIDTH);
            share[node][WIDTH - 2] = own;
            least[node][0] = below + nodes[node].aabb.half_area();
            for places in 2..WIDTH {
                let (sum, n) = divided(places);
                let fewer = least[node][places - 2];
                (least[node][places - 1], share[node][places - 2]) =
                    if sum < fewer { (sum, n) } else { (fewer, 0) };
            }
        }
        Self { share }
    }

    /// The binary nodes that become the children of the wide node at `root`.
    fn children(&self, nodes: &[Bvh2Node], root: usize) -> Vec<usize> {
        let mut children = Vec::with_capacity(WIDTH);
        let mut pending = vec![(root, WIDTH)];
        while let Some((node, mut places)) = pending.pop() {
            let is_leaf = nodes[node].is_leaf();
            while !is_leaf && places > 1 && self.share[node][places - 2] == 0 {
                places -= 1;
            }
            if is_leaf || places == 1 {
                children.push(node);
                continue;
            }
            let first = nodes[node].first_index as usize;
            let n = self.share[node][places - 2] as usize;
            pending.extend([(first + 1, places - n), (first, n)]);
        }
        children
    }
}

/// All inner nodes, parents before children.
fn inner_nodes(nodes: &[Bvh2Node]) -> Vec<usize> {
    let mut order = Vec::with_capacity(nodes.len() / 2);
    let mut pending = vec![0];
    while let Some(node) = pending.pop() {
        if !nodes[node].is_leaf() {
            let first = nodes[node].first_index as usize;
            order.push(node);
            pending.extend([first, first + 1]);
        }
    }
    order
}

fn block(binary: &Bvh2, leaf: &Bvh2Node, triangles: &[[Vec3; 3]]) -> Block {
    let first = leaf.first_index as usize;
    let primitives = &binary.primitive_indices[first..first + leaf.prim_count as usize];
    assert!(primitives.len() <= LANES, "the builder was asked for leaves of at most {LANES}");
    let mut block = Block::EMPTY;
    for (lane, &primitive) in primitives.iter().enumerate() {
        block.set(lane, &triangles[primitive as usize], primitive);
    }
    block
}

/// References waiting at most: all siblings at every level of the deepest way down, and the root.
fn stack_need(nodes: &[Node]) -> usize {
    let mut need = vec![0_usize; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        let deepest = node.children[..node.n_children as usize]
            .iter()
            .filter(|&&child| child & LEAF == 0)
            .map(|&child| need[child as usize])
            .max();
        need[i] = node.n_children as usize + deepest.unwrap_or(0);
    }
    need.first().map_or(1, |&n| n + 1)
}
