#include "protocol/run/run_context.h"

#include "protocol/plan/faces.h"

namespace abcal {

Message describe(const PlannedAngle& angle) {
  if (angle.experiment == 0) {
    const Message where("X = {x:.6g} deg, Z = {z:.6g} deg", angle.x.deg(), angle.z.deg());
    return angle.check ? Message("check pose {n}, {where}", angle.n, where) : where;
  }
  const Message circle = circle_words(angle.experiment, angle.face);
  const double alpha_deg = angle.alpha.deg();
  if (angle.sweep > 0)
    return {"{circle}, sweep {sweep}, alpha = {alpha} deg", circle, angle.sweep, alpha_deg};
  return {"{circle}, alpha = {alpha} deg", circle, alpha_deg};
}

Message RunContext::accelerometer_words() const {
  if (!beside_others) return {"accelerometer {model}", accelerometer_info.model};
  return {"item {item}, accelerometer {model}", item, accelerometer_info.model};
}

void RunContext::notify(std::string_view kind, const Message& text) const {
  if (!beside_others) return journal.notify(kind, text);
  journal.notify(kind, Message("item {item}, {what}", item, text), item);
}

}  // namespace abcal
