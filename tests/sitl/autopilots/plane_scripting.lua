-- A stand-in for those of ArduPilot's documented scripting functions that decklander_plane.lua uses.
local function reads(t, names) for _, n in ipairs(names) do t[n] = function(_, v) if v then t["_" .. n] = v end return t["_" .. n] end end end
local function vector(x, y, z) local t = { _x = x, _y = y, _z = z } reads(t, { "x", "y", "z" }) return t end
function location(lat, lng, alt)
  local t = { _lat = lat, _lng = lng, _alt = alt } reads(t, { "lat", "lng", "alt" })
  t.copy = function() return location(t._lat, t._lng, t._alt) end
  t.offset = function(_, n, e) t._lat, t._lng = t._lat + 100 * n, t._lng + 100 * e end
  t.get_distance_NED = function(_, o) return vector((o._lat - t._lat) / 100, (o._lng - t._lng) / 100, (t._alt - o._alt) / 100) end
  return t
end
Vector2f = function() return vector(0, 0) end
return function(of)
  millis = function() return { tofloat = function() return of.ms() end } end
  arming = { is_armed = function() return of.armed() end }
  ahrs = { get_location = function() return location(of.at()) end, get_velocity_NED = function() return vector(0, 0, 0) end }
  goal = location(0, 0, 0)
  vehicle = { get_mode = function() return of.mode() end, get_target_location = function() return goal end,
    update_target_location = function(_, old, new) goal = new of.moved(new._lat, new._lng, new._alt) end,
    set_velocity_match = function(_, v) of.matched(v:x(), v:y()) end }
  param = { get = function(_, n) return of.get(n) end, add_table = function() return true end, add_param = function(_, _, _, n, v) return of.add(n, v) end }
  mavlink = { init = function() end, register_rx_msgid = function(_, id) of.registered(id) end, receive_chan = function() return of.receive() end }
  gcs = { send_text = function(_, _, t) of.text(t) end }
  rc = { get_channel = function(_, n) return { set_override = function(_, pwm) of.override(n, pwm) end } end }
end
