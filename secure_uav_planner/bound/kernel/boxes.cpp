// The branch and bound of lemma 5 over the boxes of terms.hpp.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "array.hpp"
#include "terms.hpp"

namespace py = pybind11;
using kernel::Array;
using kernel::Box;
using kernel::expect;
using kernel::Expansion;
using kernel::BOX_ROUNDING;
using kernel::INFINITE;
using kernel::Terms;

namespace {

// Branch and bound, level by level of boxes, for the maxima of several functions of one cell.
class BranchAndBound {
public:
    BranchAndBound(const Terms& terms, std::size_t cell, double budget)
        : terms_(terms), cell_(cell), budget_(budget), parts_(terms.parts()) {}

    // Add function k. If the budget suffices, its bound will be at most the tolerance plus the
    // larger of the incumbent and the largest value that the search finds.
    void add(std::size_t k, double incumbent, double tolerance) {
        items_.push_back({functions_.size(), INFINITE});
        functions_.push_back({k, incumbent + tolerance, tolerance, -INFINITE, 0.0, {}, false});
    }

    // Search, and replace the incumbents of the added functions by the bounds of their maxima. The
    // best point that exceeds the incumbent goes to the function's row of `maximisers` (M, 3).
    void search(Array<double>& bounds, Array<double>& maximisers) {
        std::vector<Node> level{{terms_.bounding_box(cell_), 0, items_.size()}};
        while (!level.empty()) {
            next_nodes_.clear();
            next_items_.clear();
            for (Node& node : level) visit(node);
            std::swap(level, next_nodes_);
            std::swap(items_, next_items_);
        }
        for (const Function& function : functions_) {
            bounds[function.number] = function.bound;
            if (function.exceeds)
                std::copy(function.best, function.best + 3, &maximisers[3 * function.number]);
        }
    }

private:
    // A function: its index `number`; `enough`, the incumbent plus `tolerance`, below which a box
    // needs no halving; `bound`, the largest over the boxes that are done; the count of its boxes.
    struct Function {
        std::size_t number;
        double enough, tolerance, bound, boxes;
        double best[3];  // The best point that exceeds the incumbent, if `exceeds`.
        bool exceeds;    // Whether the search found a point that exceeds the incumbent of `add`.
    };

    // A function that needs a box, and its bound over the parent box.
    struct Item {
        std::size_t function;
        double bound;
    };

    // A box, and the range of its items.
    struct Node {
        Box box;
        std::size_t begin, end;
    };

    // Bound the functions that need a box, unless it misses the reachable set. A function whose
    // bound exceeds `enough`, incumbent plus tolerance, needs both halves of the box; the box is
    // cut for the function whose bound exceeds `enough` most. A function that has spent its budget
    // of boxes keeps its bound over the parent box if that is finite, and otherwise its bound over
    // this box.
    void visit(Node& node) {
        Box& box = node.box;
        terms_.expand(cell_, box, parts_.data());
        if (!box.meets_set) return;
        const std::size_t begin = next_items_.size();
        double most = -INFINITE;
        Expansion loosest{};
        std::size_t cut = 0;
        for (std::size_t i = node.begin; i < node.end; ++i) {
            Function& function = functions_[items_[i].function];
            double bound = items_[i].bound;  // The bound over the parent box holds here as well.
            const bool ended = function.boxes++ >= budget_;
            // Written so that a NaN is never dropped.
            if (!(bound <= function.enough) && !(ended && std::isfinite(bound))) {
                const Expansion f = terms_.sum(function.number, parts_.data());
                raise_incumbent(function, box, f.value);
                bound = terms_.bound(cell_, box, f, function.enough);
                if (!ended && !(bound <= function.enough)) {
                    next_items_.push_back({items_[i].function, bound});
                    if (!(bound - function.enough <= most)) {
                        most = bound - function.enough;
                        loosest = f;
                        cut = function.number;
                    }
                    continue;
                }
            }
            function.bound = std::isnan(bound) ? bound : std::max(function.bound, bound);
        }
        if (next_items_.size() > begin) halve(box, cut, loosest, begin);
    }

    // If the centre of a box is in the reachable set and its `value` exceeds the incumbent,
    // `enough` minus `tolerance`, make the value the incumbent and the centre the best point.
    static void raise_incumbent(Function& function, const Box& box, double value) {
        if (!box.centre_in_set || !(value + function.tolerance > function.enough)) return;
        function.enough = value + function.tolerance;
        std::copy(box.centre, box.centre + 3, function.best);
        function.exceeds = true;
    }

    // Add both halves of a box to the next level, where they share the items from `begin` on. The
    // box is cut across the side that loosens the bound of `function` most; `sum` is the expansion
    // of this function in the box.
    void halve(const Box& box, std::size_t function, const Expansion& sum, std::size_t begin) {
        // Absolute values are added, because curvatures that cancel in `sum`, and negative ones
        // where the box reaches beyond the reachable set, loosen the bound too.
        double curvature[3] = {};
        for (std::size_t part = 0; part < terms_.parts(); ++part) {
            const double factor = terms_.factor(function, part);
            const Expansion& expansion = parts_[part];
            curvature[0] += factor * std::abs(expansion.ka);
            curvature[1] += factor * std::abs(expansion.kb);
            curvature[2] += factor * std::abs(expansion.kp);
        }
        const double slope[3] = {sum.ga, sum.gb, sum.gp};
        int side = 0;
        double most = -1.0;
        for (int i = 0; i < terms_.dimensions(); ++i) {
            const double score =
                (std::abs(slope[i]) + curvature[i] * box.half[i] / 2) * box.half[i];
            if (score > most) {
                most = score;
                side = i;
            }
        }
        Node node{box, begin, next_items_.size()};
        const double width = box.half[side] / 2, middle = box.centre[side];
        // A half is widened to the spacing of floats, so that both halves cover the box.
        node.box.half[side] = width * (1 + BOX_ROUNDING) + 2e-16 * std::abs(middle);
        for (const int sign : {-1, 1}) {
            node.box.centre[side] = middle + sign * width;
            next_nodes_.push_back(node);
        }
    }

    const Terms& terms_;
    std::size_t cell_;
    double budget_;
    std::vector<Expansion> parts_;
    std::vector<Function> functions_;
    std::vector<Item> items_, next_items_;  // Items of the present and of the next level.
    std::vector<Node> next_nodes_;
};

// Prove an upper bound [nats] of the maximum of each of `functions`, which are indices of M
// functions. They share the boxes of a branch and bound, and so must have one cell. `bounds` (M)
// holds an incumbent of each function, a guess of the maximum, which the bound replaces.
// `tolerances` (M): how far a bound may exceed the larger of the maximum and the incumbent.
// `budget`: number of boxes after which a function's bound is taken as it is.
// `maximisers` (M, 3): place and log power of the best point that exceeds the incumbent; the row of
// a function without such a point is left as it is.
void bound_maxima(const Terms& terms, const py::buffer& functions, const py::buffer& bounds,
                  const py::buffer& tolerances, double budget, const py::buffer& maximisers) {
    const Array<const std::int64_t> index(functions, "functions");
    Array<double> bound(bounds, "bounds", terms.size());
    const Array<const double> tolerance(tolerances, "tolerance", terms.size());
    Array<double> best(maximisers, "maximisers", 3 * terms.size());
    expect(index.size() > 0, "functions");
    for (std::size_t i = 0; i < index.size(); ++i)
        expect(index[i] >= 0 && std::size_t(index[i]) < terms.size()
                   && terms.cell(std::size_t(index[i])) == terms.cell(std::size_t(index[0])),
               "functions");
    const py::gil_scoped_release release;
    BranchAndBound tree(terms, terms.cell(std::size_t(index[0])), budget);
    for (std::size_t i = 0; i < index.size(); ++i) {
        const std::size_t function = std::size_t(index[i]);
        tree.add(function, bound[function], tolerance[function]);
    }
    tree.search(bound, best);
}

// Return a function's value at the centre of a box, and Terms::bound, an upper bound over the box,
// without a value that is enough: for tests.
py::tuple bound_box(const Terms& terms, std::size_t function, const py::buffer& centre,
                    const py::buffer& half) {
    expect(function < terms.size(), "function");
    const Array<const double> middle(centre, "centre", terms.dimensions());
    const Array<const double> sides(half, "half", terms.dimensions());
    Box box{};
    for (int i = 0; i < terms.dimensions(); ++i) {
        box.centre[i] = middle[i];
        box.half[i] = sides[i];
    }
    std::vector<Expansion> parts(terms.parts());
    const std::size_t cell = terms.cell(function);
    terms.expand(cell, box, parts.data());
    const Expansion f = terms.sum(function, parts.data());
    return py::make_tuple(f.value, terms.bound(cell, box, f, -INFINITE));
}

}  // namespace

// Add the classes of this file to the Python module of the kernel.
void add_bound_boxes(py::module_& module) {
    using kernel::Detours;
    using kernel::Links;
    using kernel::ReachableSet;
    using py::arg;
    using Buffer = const py::buffer&;
    py::class_<Detours, std::shared_ptr<Detours>>(module, "Detours")
        .def(py::init<Buffer, Buffer, Buffer>(), arg("low"), arg("size"), arg("lengths"));
    py::class_<ReachableSet, std::shared_ptr<ReachableSet>>(module, "ReachableSet")
        .def(py::init<double, Buffer, Buffer, Buffer, Buffer, Buffer, std::shared_ptr<Detours>>(),
             arg("distance"), arg("from_start"), arg("to_goal"), arg("corner"), arg("low"),
             arg("high"), arg("detours"));
    py::class_<Links, std::shared_ptr<Links>>(module, "Links")
        .def(py::init<double, double, Buffer, Buffer, Buffer, Buffer>(), arg("altitude"),
             arg("log_gain"), arg("ground"), arg("eavesdroppers"), arg("radii"),
             arg("log_advantages"));
    py::class_<Terms>(module, "Terms")
        .def(py::init<std::shared_ptr<ReachableSet>, std::shared_ptr<Links>, Buffer, Buffer,
                      Buffer, Buffer, Buffer, Buffer, Buffer, double,
                      std::optional<std::pair<double, double>>>(),
             arg("region"), arg("links"), arg("cell"), arg("weight"), arg("v"), arg("slope"),
             arg("curvature"), arg("speed_cost"), arg("margin"), arg("price"), arg("powers"))
        .def("bound_maxima", &bound_maxima)
        .def("bound_box", &bound_box);
}
