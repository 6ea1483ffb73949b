// The compiled module; core.pyi says what is in it.
#include <pybind11/pybind11.h>

#include <memory>

#include "array.hpp"
#include "link_gains.hpp"

namespace py = pybind11;

void add_interior_point(py::module_& module);  // interior_point.cpp
void add_bound_boxes(py::module_& module);     // bound/kernel/boxes.cpp
void add_bound_dual(py::module_& module);      // bound/kernel/dual.cpp
void add_bound_slots(py::module_& module);     // bound/kernel/slots.cpp
void add_discs(py::module_& module);           // discs.cpp
void add_limits(py::module_& module);          // limits.cpp

using kernel::copy_reals;
using kernel::count_entries;
using kernel::expect;

namespace {

// Check and copy the numbers of FreeSpace: SNR at unit distance and power, and H^2, of each link.
std::shared_ptr<kernel::FreeSpace> make_free_space(const py::buffer& snr,
                                                   const py::buffer& squared_altitudes) {
    const std::size_t links = count_entries(snr);
    return std::make_shared<kernel::FreeSpace>(
        copy_reals(snr, "snr", links), copy_reals(squared_altitudes, "squared_altitudes", links));
}

// Check and copy the numbers of PathLoss; each array has one for each link.
std::shared_ptr<kernel::PathLoss> make_path_loss(
    const py::buffer& snr, const py::buffer& squared_altitudes, const py::buffer& losses,
    const py::buffer& steepness, const py::buffer& shift, double exponent, bool quantile) {
    const std::size_t links = count_entries(snr);
    return std::make_shared<kernel::PathLoss>(
        copy_reals(snr, "snr", links), copy_reals(squared_altitudes, "squared_altitudes", links),
        copy_reals(losses, "losses", links), copy_reals(steepness, "steepness", links),
        copy_reals(shift, "shift", links), exponent, quantile);
}

// Return bounds of |f'|, |f''| and |f'''| of f = log gain from `near` to `far` [m]; see core.pyi.
py::tuple bound_log_gain(const kernel::PathLoss& channel, std::size_t link, double near,
                         double far) {
    expect(link < channel.links() && near <= far, "link, near, far");
    const kernel::PathLoss::LogBounds bounds = channel.bound_log_gain(link, near, far);
    return py::make_tuple(bounds.first, bounds.second, bounds.third);
}

// Return a link's gain() at a squared distance, and value, first and second derivative by the
// squared distance of derivatives(): for tests.
py::tuple find_gain(const kernel::LinkGains& gains, std::size_t link, double squared) {
    expect(link < gains.links(), "link");
    const kernel::Gain gain = gains.derivatives(link, squared);
    return py::make_tuple(gains.gain(link, squared), gain.value, gain.first, gain.second);
}

}  // namespace

PYBIND11_MODULE(_secure_uav_planner_kernel, module) {
    module.doc() = "Newton steps, the limits in them, the proof of the worst case and the bound.";
    module.attr("sources") = KERNEL_SOURCES;
    py::class_<kernel::LinkGains, std::shared_ptr<kernel::LinkGains>>(module, "LinkGains")
        .def("gain", &find_gain);
    py::class_<kernel::FreeSpace, kernel::LinkGains, std::shared_ptr<kernel::FreeSpace>>(
        module, "FreeSpace").def(py::init(&make_free_space));
    py::class_<kernel::PathLoss, kernel::LinkGains, std::shared_ptr<kernel::PathLoss>>(
        module, "PathLoss").def(py::init(&make_path_loss)).def("bound_log_gain", &bound_log_gain);
    add_limits(module);
    add_interior_point(module);
    add_discs(module);
    add_bound_boxes(module);
    add_bound_dual(module);
    add_bound_slots(module);
}
