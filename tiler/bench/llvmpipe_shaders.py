"""The pipeline's stages in GLSL, for llvmpipe: the same patch, displacement, normal and light as `pipeline` computes."""

VERTEX = """
#version 450 core
in vec4 position;
in vec2 texcoord;
out vec4 control;
out vec2 corner;
void main() { control = position; corner = texcoord; }
"""

# Control points 0 .. 3 of a patch bring its texture corners.
TESS_CONTROL = """
#version 450 core
layout(vertices = 16) out;
in vec4 control[];
in vec2 corner[];
out vec4 point[];
patch out vec2 st[4];
uniform float factor[6];
void main() {
    point[gl_InvocationID] = control[gl_InvocationID];
    if (gl_InvocationID == 0) {
        for (int k = 0; k < 4; ++k) {
            st[k] = corner[k];
            gl_TessLevelOuter[k] = factor[k];
        }
        gl_TessLevelInner[0] = factor[4];
        gl_TessLevelInner[1] = factor[5];
    }
}
"""

# @SPACING@, @DISPLACED@ and @RATIONAL@ are set for the scene: nothing is computed that its patches do not need.
TESS_EVALUATION = """
#version 450 core
#define DISPLACED @DISPLACED@
#define RATIONAL @RATIONAL@
layout(quads, @SPACING@, cw) in;
in vec4 point[];
patch in vec2 st[4];
out vec3 normal;
uniform mat4 clip_from_world;
uniform sampler2D map;
uniform float scale, bias;

#if RATIONAL
#define V vec4
#define POINT(k) point[k]
#else
#define V vec3
#define POINT(k) point[k].xyz
#endif

void main() {
    float u = gl_TessCoord.x, v = gl_TessCoord.y, u0 = 1.0 - u, v0 = 1.0 - v;
    vec4 bu = vec4(u0 * u0 * u0, 3.0 * u * u0 * u0, 3.0 * u * u * u0, u * u * u);
    vec4 bv = vec4(v0 * v0 * v0, 3.0 * v * v0 * v0, 3.0 * v * v * v0, v * v * v);
    vec3 qu = vec3(u0 * u0, 2.0 * u * u0, u * u), qv = vec3(v0 * v0, 2.0 * v * v0, v * v);
    V along_v[4], slope_v[4];
    for (int i = 0; i < 4; ++i) {
        V a = POINT(4 * i), b = POINT(4 * i + 1), c = POINT(4 * i + 2), d = POINT(4 * i + 3);
        along_v[i] = bv.x * a + bv.y * b + bv.z * c + bv.w * d;
        slope_v[i] = qv.x * (b - a) + qv.y * (c - b) + qv.z * (d - c);
    }
    V h = bu.x * along_v[0] + bu.y * along_v[1] + bu.z * along_v[2] + bu.w * along_v[3];
    V hu = qu.x * (along_v[1] - along_v[0]) + qu.y * (along_v[2] - along_v[1]) + qu.z * (along_v[3] - along_v[2]);
    V hv = bu.x * slope_v[0] + bu.y * slope_v[1] + bu.z * slope_v[2] + bu.w * slope_v[3];
#if RATIONAL
    vec3 p = h.xyz / h.w, pu = (hu.xyz - hu.w * p) / h.w, pv = (hv.xyz - hv.w * p) / h.w;
#else
    vec3 p = h, pu = hu, pv = hv;
#endif
    vec3 across = cross(pu, pv), n = dot(across, across) > 0.0 ? normalize(across) : vec3(0.0);
    normal = n;
#if DISPLACED
    vec2 s = v0 * (u0 * st[0] + u * st[1]) + v * (u0 * st[2] + u * st[3]);
    vec2 size = vec2(textureSize(map, 0)), part = fract(s * size - 0.5);
    vec4 t = textureGather(map, s);  // (0, 1), (1, 1), (1, 0), (0, 0)
    float lower = mix(t.w, t.z, part.x), upper = mix(t.x, t.y, part.x);
    vec2 rise = scale * size * vec2(mix(t.z - t.w, t.y - t.x, part.y), upper - lower);
    float along_u = dot(rise, v0 * (st[1] - st[0]) + v * (st[3] - st[2]));
    float across_v = dot(rise, u0 * (st[2] - st[0]) + u * (st[3] - st[1]));
    normal = normalize(3.0 * across + across_v * cross(pu, n) + along_u * cross(n, pv));
    p += (scale * mix(lower, upper, part.y) + bias) * n;
#endif
    gl_Position = clip_from_world * vec4(p, 1.0);
}
"""

FRAGMENT = """
#version 450 core
in vec3 normal;
out vec4 color;
uniform vec3 light, clay, ambient;
void main() {
    float wrapped = 0.5 + 0.5 * dot(normalize(normal), light);
    color = vec4(sqrt(clay * (ambient + (1.0 - ambient) * wrapped * wrapped)), 1.0);
}
"""
